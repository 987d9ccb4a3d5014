"""The command `gmdx sensitivity`."""

from dataclasses import dataclass, field

from gmdx.cli.exits import Exit
from gmdx.cli.options import ConfigFile, Folder, Objects, Settings
from gmdx.cli.terminal import console, following, say
from gmdx.machine.cores import available_cores
from gmdx.studies.sensitivity import SensitivityConfig, sensitivity_study, summary, table


@dataclass(frozen=True)
class Sensitivity:
    """Find out which physical and numerical parameters the labels depend on.

    Scenes and grasps stay the same; the trials change. Run it again to continue.
    """

    objects: Objects
    out: Folder
    """folder of the study"""
    config: ConfigFile = None
    settings: Settings[SensitivityConfig] = field(
        default_factory=lambda: SensitivityConfig(workers=available_cores())
    )

    def run(self) -> int:
        """Run the study, and show what matters most."""
        with following("trials", things="runs") as show:
            study = sensitivity_study(self.objects, self.out, self.settings, on_progress=show)
        console().print(table(summary(study)))
        say(f"{study.root}: runs.parquet, sensitivity.json, figures/ and report.html")
        return Exit.DONE
