"""The command `gmdx`: finds out which command is meant, runs it, and says how it ended."""

import os
import sys
from collections.abc import Sequence
from dataclasses import make_dataclass
from typing import Annotated, Any, NoReturn, Union

import tyro
from tyro.conf import subcommand

from gmdx.cli.commands import COMMANDS, Group
from gmdx.cli.exits import Exit
from gmdx.cli.flags import Command, parse
from gmdx.cli.terminal import complain, interrupts_kept
from gmdx.errors import GmdxError, GripperError, UsageError
from gmdx.machine.cores import THREAD_VARIABLES


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: Words of the command line; those of this process by default.

    Returns:
        The exit code: 0 the run finished, 1 nothing was produced, 2 wrong usage, 130 interrupted.
    """
    for name in THREAD_VARIABLES:  # workers are the parallelism
        os.environ.setdefault(name, "1")
    try:
        return asked_for(sys.argv[1:] if argv is None else argv).run()
    except KeyboardInterrupt:
        complain("interrupted; the same command continues after what is complete")
        return Exit.INTERRUPTED
    except GmdxError as error:
        complain(f"gmdx: {error}")
        wrong = isinstance(error, UsageError | GripperError)
        return Exit.WRONG_USAGE if wrong else Exit.FAILED
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.DONE


def asked_for(words: Sequence[str], group: Group = COMMANDS, *, prog: str = "gmdx") -> Command:
    """The command that the words of a command line ask for; ends the process after a `--help`."""
    entry = group.entries.get(words[0]) if words else None
    if entry is None:
        _explain(group, words, prog=prog)
    prog = f"{prog} {words[0]}"
    if isinstance(entry, Group):
        return asked_for(words[1:], entry, prog=prog)
    with interrupts_kept():
        command = entry.load()
    return parse(command, words[1:], prog=prog)


def _explain(group: Group, words: Sequence[str], *, prog: str) -> NoReturn:
    """The help of a group, or what is wrong with words that name none of its commands."""
    members = [
        Annotated[make_dataclass(name, ()), subcommand(name, description=entry.summary)]
        for name, entry in group.entries.items()
    ]
    choice: Any = Union[tuple(members)]  # noqa: UP007
    tyro.cli(choice, prog=prog, description=group.summary, args=words)
    raise UsageError(f"{prog} has no command among: {' '.join(words)}")
