"""The modules of a tree and what they import, read from the source with ast."""

import ast
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path


@dataclass(frozen=True)
class Import:
    """A module needs another one, or a name of it."""

    at: str  # the module that needs it
    target: str  # the module that is needed
    name: str  # of it; "" where the whole module is meant
    typing_only: bool  # under `if TYPE_CHECKING`


@dataclass(frozen=True)
class House:
    """All modules of one package: those under `root / package`."""

    root: Path
    package: str

    @cached_property
    def modules(self) -> dict[str, Path]:
        """Files by the modules' dotted names; a folder's name stands for its door."""
        found = {}
        for path in sorted((self.root / self.package).rglob("*.py")):
            words = path.relative_to(self.root).with_suffix("").parts
            found[".".join(words[:-1] if words[-1] == "__init__" else words)] = path
        return found

    @cached_property
    def imports(self) -> tuple[Import, ...]:
        """Everything that any module imports, at any depth, type checking included."""
        return tuple(found for module in self.modules for found in self._imports_of(module))

    @cached_property
    def graph(self) -> dict[str, set[str]]:
        """What runs before each module does: what it imports, and the doors on the way there."""
        needs: dict[str, set[str]] = {module: set() for module in self.modules}
        for found in self.imports:
            if found.target in self.modules:
                own = set(lineage(found.at))
                needs[found.at] |= {m for m in lineage(found.target) if m not in own}
        return needs

    def folder(self, module: str) -> str:
        """The folder that a module lies in, dotted; a door lies in its own."""
        door = self.modules[module].name == "__init__.py"
        return module if door else module.rpartition(".")[0]

    def _imports_of(self, module: str) -> Iterator[Import]:
        tree = ast.parse(self.modules[module].read_text())
        typing_only = {
            id(inner)
            for node in ast.walk(tree)
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
            for statement in node.body
            for inner in ast.walk(statement)
        }
        for node in ast.walk(tree):
            for target, name in self._named(node, module):
                yield Import(module, target, name, id(node) in typing_only)

    def _named(self, node: ast.AST, module: str) -> Iterator[tuple[str, str]]:
        """Modules and names that a node imports."""
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            folder = self.folder(module).split(".")
            above = folder[: len(folder) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                whole = f"{base}.{alias.name}"
                yield (whole, "") if whole in self.modules else (base, alias.name)
        elif isinstance(node, ast.Constant) and node.value in self.modules and "." in node.value:
            # In a table of what is imported later, or as what another process is to run.
            yield node.value, ""


def lineage(module: str) -> list[str]:
    """A module and the folders around it, innermost first."""
    words = module.split(".")
    return [".".join(words[:end]) for end in range(len(words), 0, -1)]


def reachable(graph: Mapping[str, Iterable[str]], starts: Iterable[str]) -> set[str]:
    """All that is needed, directly or not, by the starts; they are among it."""
    seen: set[str] = set()
    ahead = list(starts)
    while ahead:
        node = ahead.pop()
        if node not in seen:
            seen.add(node)
            ahead += graph[node]
    return seen


def circles(graph: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """Groups of nodes that need each other: strongly connected ones (Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for other in graph[node]:
            if other not in index:
                visit(other)
                low[node] = min(low[node], low[other])
            elif other in stack:
                low[node] = min(low[node], index[other])
        if low[node] == index[node]:
            at = stack.index(node)
            group = sorted(stack[at:])
            del stack[at:]
            if len(group) > 1:
                found.append(group)

    for node in graph:
        if node not in index:
            visit(node)
    return found
