"""The command `gmdx bench depth`: depth images per second."""

import dataclasses

from gmdx.cli.bench.scenes import fresh_scenes
from gmdx.cli.exits import Exit
from gmdx.cli.options import BenchObjects, Json
from gmdx.cli.tables import show_records
from gmdx.studies.throughput import depth_figures


@dataclasses.dataclass(frozen=True)
class Depth:
    """Depth images per second."""

    objects: BenchObjects = ("bundled",)
    """what to look at"""
    images: int = 16
    """images per object"""
    json: Json = False
    """print JSON instead of a table"""

    def run(self) -> int:
        """Render every object several times."""
        found = [depth_figures(scene, images=self.images) for scene in fresh_scenes(self.objects)]
        show_records("gmdx bench depth (640 x 480)", found, as_json=self.json)
        return Exit.DONE
