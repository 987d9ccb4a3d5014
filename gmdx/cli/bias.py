"""The command `gmdx bias`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from rich.table import Table

from gmdx.cli.exits import Exit
from gmdx.cli.options import ConfigFile, CountOrAll, DatasetFolder, Folder, Settings
from gmdx.cli.terminal import console, following, say
from gmdx.machine.cores import available_cores
from gmdx.studies.bias import BiasConfig, bias_study, summary, summary_head


@dataclass(frozen=True)
class Bias:
    """Find out how much a dataset's labels depend on the simulator: its grasps in another one.

    The same grasps, scenes, schedule and pose noise run in both engines, and in the dataset's own
    with other noise, half the time step and other hulls: the noise floor. Run it again to continue.
    """

    FLAGS: ClassVar[Mapping[Any, Any]] = {(BiasConfig, "grasps"): CountOrAll}

    dataset: DatasetFolder
    out: Folder
    """folder of the study: pairs.parquet, bias.json, report.html"""
    config: ConfigFile = None
    settings: Settings[BiasConfig] = field(
        default_factory=lambda: BiasConfig(workers=available_cores())
    )

    def run(self) -> int:
        """Run the study, and show how far the engines agree."""
        with following("grasps", things="replays") as show:
            study = bias_study(self.dataset, self.out, self.settings, on_progress=show)
        table = Table(*summary_head(study), title=f"{study.engines.grasps} grasps in both engines")
        rows = list(summary(study))
        for row in rows:
            table.add_row(*row)
        if any(cell.endswith("*") for row in rows for cell in row):
            table.caption = "* Student's t: too few objects differ to resample"
        console().print(table)
        failed = f"; {len(study.failures)} replays failed" if study.failures else ""
        say(f"{study.root}: pairs.parquet, bias.json and report.html{failed}")
        return Exit.DONE if study.engines.grasps else Exit.FAILED
