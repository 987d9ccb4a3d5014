"""The command `gmdx prepare`."""

from dataclasses import dataclass, field

from gmdx.cli.exits import Exit
from gmdx.cli.options import Objects
from gmdx.cli.terminal import say
from gmdx.errors import GmdxError, UsageError
from gmdx.machine.cores import available_cores
from gmdx.machine.tasks import run_tasks
from gmdx.objects.prepare import CacheOption, prepare
from gmdx.objects.report import describe
from gmdx.objects.sources import ObjectSource, resolve


@dataclass(frozen=True)
class Prepare:
    """Prepare objects for physics, and report what was repaired."""

    objects: Objects
    workers: int = field(default_factory=available_cores)
    """processes"""
    cache: CacheOption = "user"
    """folder of prepared objects; "user": the user's own"""

    def run(self) -> int:
        """Print a report per object."""
        sources = resolve(list(self.objects))
        if self.workers < 1:
            raise UsageError(f"--workers must be at least 1, not {self.workers}")
        tasks = [_Task(source, self.cache) for source in sources]
        failed = 0
        for finished in run_tasks(_prepared, tasks, workers=min(self.workers, len(tasks))):
            object_id, result = finished.task.source.object_id, finished.result
            if isinstance(result, _Report):
                say(result.text)
            else:
                failed += 1
                say(f"{object_id}: failed: {result}")
        say(f"{len(tasks) - failed} objects prepared, {failed} failed")
        return Exit.DONE if failed < len(tasks) else Exit.FAILED


@dataclass(frozen=True)
class _Task:
    source: ObjectSource
    cache: CacheOption


@dataclass(frozen=True)
class _Report:
    text: str


def _prepared(task: _Task) -> _Report | str:
    """The report on one object, or why there is none."""
    try:
        return _Report(describe(prepare(task.source, cache=task.cache)))
    except GmdxError as error:
        return str(error)
    except Exception as error:  # one object's surprise is not the others'
        return f"{type(error).__name__}: {error}"
