"""The command `gmdx generate`."""

from dataclasses import dataclass, field

from gmdx.cli.config import on_all_cores
from gmdx.cli.exits import Exit
from gmdx.cli.options import ConfigFile, Folder, Objects, Settings
from gmdx.cli.terminal import following, interrupts_kept, say
from gmdx.pipeline.generate import GenerateConfig, Summary, generate
from gmdx.trials.engines import open_engine


@dataclass(frozen=True)
class Generate:
    """Annotate objects with grasps, trials and metrics. Run it again to continue.

    Every setting that `gmdx config` prints is a flag as well: `lift_time` of its section [trial] is
    --trial.lift-time. `gmdx generate --help-all` lists them.
    """

    objects: Objects
    out: Folder
    """folder of the dataset"""
    config: ConfigFile = None
    settings: Settings[GenerateConfig] = field(default_factory=on_all_cores)

    def run(self) -> int:
        """Generate the dataset."""
        with interrupts_kept():
            open_engine(self.settings.engine)  # imports what it needs
        with following("grasps") as on_progress:
            summary = generate(self.objects, self.out, self.settings, on_progress=on_progress)
        say(_last_line(summary))
        return Exit.DONE if summary.counts["objects"] else Exit.FAILED


def _last_line(summary: Summary) -> str:
    """What a run came to."""
    counts = summary.counts
    there = f", {summary.present} already there" if summary.present else ""
    return (
        f"{summary.root}: {counts['objects']} objects, {counts['scenes']} scenes, "
        f"{counts['grasps']} grasps ({summary.produced} objects new{there}); "
        f"{summary.failed} of {summary.requested} objects failed, "
        f"{counts['failures']} lines in failures.jsonl"
    )
