"""The command `gmdx show`."""

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from gmdx.cli.exits import Exit
from gmdx.cli.options import CountOrAll, DatasetFolder, File
from gmdx.cli.terminal import say
from gmdx.dataset.read import read_dataset
from gmdx.pictures.figure import DrawConfig, save_figure
from gmdx.pictures.show import grasp_picture, scene_picture


@dataclass(frozen=True)
class Show:
    """Draw a scene's grasps over its depth image, or one grasp's contacts from close up."""

    dataset: DatasetFolder
    object: Annotated[str, arg(metavar="ID")]
    """which object"""
    out: Annotated[File, arg(aliases=("-o",))]
    """picture to write: .png, .pdf or .svg"""
    scene: int = 0
    """which scene of the object"""
    metric: str = "sim_success"
    """what the colours show; `gmdx metrics` lists the names"""
    view: int = 0
    """which image of the scene"""
    most: CountOrAll = DrawConfig.most
    """draw at most so many grasps, spread over the scene; 0: all"""
    grasp: Annotated[int | None, arg(metavar="ID", help_behavior_hint="(default: none)")] = None
    """draw this grasp from close up instead"""

    def run(self) -> int:
        """Write the picture."""
        dataset = read_dataset(self.dataset)
        if self.grasp is None:
            figure = scene_picture(
                dataset, self.object, self.scene, metric=self.metric, view=self.view, most=self.most
            )
        else:
            figure = grasp_picture(dataset, self.object, self.scene, self.grasp)
        save_figure(figure, self.out)
        say(f"wrote {self.out}")
        return Exit.DONE
