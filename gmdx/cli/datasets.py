"""The commands that print tables: `gmdx inspect`, `gmdx metrics`."""

from dataclasses import dataclass

from rich.table import Table

from gmdx.cli.exits import Exit
from gmdx.cli.options import DatasetFolder
from gmdx.cli.terminal import console


@dataclass(frozen=True)
class Inspect:
    """Show what a dataset holds: counts, success, outcomes, missing values, failures, cost."""

    dataset: DatasetFolder

    def run(self) -> int:
        """Print the tables."""
        from gmdx.dataset.inspect import overview, tables
        from gmdx.dataset.read import read_dataset

        screen = console()
        for table in tables(overview(read_dataset(self.dataset))):
            screen.print(table)
        return Exit.DONE


@dataclass(frozen=True)
class Metrics:
    """Print the table of the 36 metrics."""

    def run(self) -> int:
        """Print one row a metric."""
        from gmdx.metrics.table import METRICS

        table = Table("#", "name", "kind", "unit", "definition", title="The 36 metrics")
        for metric in METRICS:
            unit = metric.unit if metric.unit else "-"
            table.add_row(str(metric.number), metric.name, metric.kind, unit, metric.definition)
        console().print(table)
        return Exit.DONE
