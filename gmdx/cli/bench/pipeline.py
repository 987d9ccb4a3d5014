"""The command `gmdx bench pipeline`: what a grasp costs, by stage, and what more workers bring."""

import dataclasses
import json
import tempfile
from pathlib import Path

from rich.table import Table

from gmdx.cli.exits import Exit
from gmdx.cli.options import BenchObjects, Json, NumberList, number_list
from gmdx.cli.terminal import console, following, say
from gmdx.dataset.read import read_dataset
from gmdx.errors import UsageError
from gmdx.pipeline.generate import GenerateConfig, generate
from gmdx.studies.throughput import peak_megabytes, pipeline_figures, rows, worker_figures


@dataclasses.dataclass(frozen=True)
class Pipeline:
    """Seconds per grasp of the whole pipeline by stage, and what more workers bring."""

    objects: BenchObjects = ("bundled",)
    """what to annotate"""
    grasps: int = GenerateConfig.grasps
    """grasps per scene"""
    scenes: int = GenerateConfig.scenes
    """scenes per object"""
    workers: NumberList = "1"
    """numbers of processes to compare; the first run gives the figures by stage"""
    json: Json = False
    """print JSON instead of a table"""

    def run(self) -> int:
        """Prepare the objects once, run the rest with each number of workers, and show both."""
        counts = number_list(self.workers, option="--workers")
        if not counts:
            raise UsageError("--workers takes numbers such as 1,2")
        with tempfile.TemporaryDirectory() as folder:
            cache = Path(folder) / "cache"
            config = GenerateConfig(grasps=self.grasps, scenes=self.scenes, cache=cache)

            def run(workers: int) -> None:
                with following("grasps") as show:
                    chosen = dataclasses.replace(config, workers=workers)
                    out = Path(folder) / f"workers{workers}"
                    generate(self.objects, out, chosen, on_progress=show)

            first = dataclasses.replace(config, grasps=1, scenes=1, workers=max(counts))
            with following("grasps") as show:
                generate(self.objects, Path(folder) / "first", first, on_progress=show)
            compared = worker_figures(run, counts)
            figures = pipeline_figures(read_dataset(Path(folder) / f"workers{counts[0]}"))
            prepared = pipeline_figures(read_dataset(Path(folder) / "first")).prepare_seconds
        figures = dataclasses.replace(figures, prepare_seconds=prepared)
        if self.json:
            runs = [dataclasses.asdict(run) for run in compared]
            values = {
                **dataclasses.asdict(figures),
                "total": figures.total,
                "workers": runs,
                "peak_megabytes": peak_megabytes(),
            }
            say(json.dumps(values, indent=1))
            return Exit.DONE
        table = Table("stage", "processor time", title="gmdx bench pipeline")
        for name, value in rows(figures):
            table.add_row(name, value)
        for item in compared:
            what = f"{item.wall_seconds:.1f} s on the clock, {item.ratio:.2f} times the first"
            table.add_row(f"{item.workers} workers", what)
        table.add_row("memory of the largest process", f"{peak_megabytes():.0f} MB at the most")
        console().print(table)
        return Exit.DONE
