"""The command `gmdx config`."""

from dataclasses import dataclass, field

from gmdx.cli.exits import Exit
from gmdx.cli.options import ConfigFile, Settings
from gmdx.cli.terminal import say
from gmdx.config import as_toml
from gmdx.machine.cores import available_cores
from gmdx.pipeline.config import GenerateConfig


def on_all_cores() -> GenerateConfig:
    """The defaults, with a process for each core."""
    return GenerateConfig(workers=available_cores())


@dataclass(frozen=True)
class Config:
    """Print every setting of `gmdx generate` as a TOML file to edit.

    The flags of `gmdx generate` are taken as well: what is printed is what they come to.
    """

    config: ConfigFile = None
    settings: Settings[GenerateConfig] = field(default_factory=on_all_cores)

    def run(self) -> int:
        """Print the defaults, the file's settings over them, and the flags over both."""
        say(as_toml(self.settings).rstrip())
        return Exit.DONE
