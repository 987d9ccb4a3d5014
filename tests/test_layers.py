"""The house holds: imports flow one way, families have doors, modules stay short.

`tests/house.py` reads the imports from the source. Each rule is a function from a house to the
places that break it; crafted houses show that each rule sees what it is there for.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path

import pytest

import gmdx
from tests.house import House, Import, circles, lineage, reachable

ROOT = Path(__file__).parents[1]
# A room imports from rooms left of it and from the ground floor, whose modules need only each
# other. Rooms that are not built yet have their place already.
GROUND = ("errors", "arrays", "rng", "geometry", "config")
ROOMS = (
    "machine", "files", "statistics", "objects", "scenes", "grasps", "trials", "metrics",
    "dataset", "formats", "pictures", "evaluators", "detectors", "browser", "studies",
    "pipeline", "cli",
)  # fmt: skip
SEES_ALL = ("pipeline", "cli", "__init__")  # these alone may need every room
LONGEST = 330  # lines of a module
HOUSE = House(ROOT, "gmdx")
KERNELS = House(ROOT / "kernels", "gmdx_kernels")
ASSETS = House(ROOT / "assets", "gmdx_assets")
NOTEBOOKS = House(ROOT / "notebooks", "epsilon_figures")
ALL = (HOUSE, KERNELS, ASSETS, NOTEBOOKS)


def room(module: str) -> str:
    """`gmdx.scenes.camera` lies in `scenes`; `gmdx.__main__` is the command line's other name."""
    words = module.split(".")
    name = words[1] if len(words) > 1 else "__init__"
    return "cli" if name == "__main__" else name


def may_need(home: str) -> set[str]:
    """The rooms whose modules a room's own may import."""
    if home in GROUND:
        return set(GROUND)
    if home == "__init__":
        return {*GROUND, *ROOMS}
    return {*GROUND, *ROOMS[: ROOMS.index(home) + 1]}


def told(found: Import) -> str:
    """An import in words."""
    return f"{found.at} imports {'.'.join(filter(None, [found.target, found.name]))}"


def without_place(house: House) -> list[str]:
    """Modules in no declared room, and rooms with nothing in them."""
    known = {*GROUND, *ROOMS, "__init__"}
    lost = [module for module in house.modules if room(module) not in known]
    doors = [m for m, path in house.modules.items() if path.name == "__init__.py"]
    empty = [d for d in doors if not any(d in lineage(m)[1:] for m in house.modules)]
    return [*lost, *empty]


def backward(house: House) -> list[str]:
    """Imports against the flow."""
    return [
        told(found)
        for found in house.imports
        if found.target in house.modules and room(found.target) not in may_need(room(found.at))
    ]


def round_trips(house: House) -> list[list[str]]:
    """Circles of modules, and of rooms."""
    rooms: dict[str, set[str]] = {room(module): set() for module in house.graph}
    for module, needs in house.graph.items():
        rooms[room(module)] |= {room(needed) for needed in needs}
    return circles(house.graph) + circles(rooms)


def too_long(house: House) -> list[str]:
    """Modules that cannot be read from top to bottom."""
    lines = {m: len(path.read_text().splitlines()) for m, path in house.modules.items()}
    return [f"{module}: {count} lines" for module, count in lines.items() if count > LONGEST]


def private_across_folders(house: House) -> list[str]:
    """Imports of a name, or from a module, that starts with `_`, by another folder's modules."""
    broken = []
    for found in house.imports:
        words = [*found.target.split("."), *([found.name] if found.name else [])]
        for depth, word in enumerate(words):
            private = word.startswith("_") and not word.startswith("__")
            home = words[:depth] if depth < len(found.target.split(".")) else words[: depth - 1]
            if found.target in house.modules and private and home:
                inside = house.folder(found.at).split(".")[: len(home)] == home
                broken += [] if inside else [told(found)]
    return broken


def families(house: House) -> set[str]:
    """Folders inside of rooms."""
    doors = (m for m, path in house.modules.items() if path.name == "__init__.py")
    return {door for door in doors if door.count(".") >= 2}


def past_doors(house: House) -> list[str]:
    """Imports from a family's modules by what is not of the family, instead of from its door."""
    inside = {m: house.folder(m) for m in house.modules if house.folder(m) in families(house)}
    return [
        told(found)
        for found in house.imports
        if found.target in inside
        and found.target != inside[found.target]
        and inside[found.target] not in lineage(found.at)
    ]


LAZY = {"import_module", "TYPE_CHECKING", "Any"}  # of a door that imports on first use


def unsaid_doors(house: House) -> list[str]:
    """Families whose door does not say what they are, or does not list what it has."""
    found = []
    for door in sorted(families(house)):
        tree = ast.parse(house.modules[door].read_text())
        # A door that imports on first use names its modules in a table, too, by "".
        offered = {i.name for i in house.imports if i.at == door} - LAZY - {""}
        listed = {
            name
            for node in tree.body
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
            for name in ast.literal_eval(node.value)
        }
        if not ast.get_docstring(tree) or not offered or offered != listed:
            found.append(door)
    return found


def draws_elsewhere(house: House) -> list[str]:
    """Imports of matplotlib at run time outside of `pictures`."""
    return [
        told(found)
        for found in house.imports
        if found.target.split(".")[0] in ("matplotlib", "mpl_toolkits")
        and not found.typing_only
        and room(found.at) != "pictures"
    ]


def unused(house: House) -> list[str]:
    """Modules that nothing which a user starts from ever needs."""
    starts = {"gmdx", "gmdx.__main__", "gmdx.studies"} & house.modules.keys()
    return sorted(house.modules.keys() - reachable(house.graph, starts))


def unregistered(house: House) -> list[str]:
    """Modules beside a registry, or in folders beside it, that it does not come to."""
    found = []
    for module in house.modules:
        if module.endswith(".registry"):
            folder, reached = house.folder(module), reachable(house.graph, [module])
            found += [m for m in house.modules if folder in lineage(m)[1:] and m not in reached]
    return found


RULES: tuple[Callable[[House], list], ...] = (
    without_place,
    backward,
    round_trips,
    too_long,
    private_across_folders,
    past_doors,
    unsaid_doors,
    draws_elsewhere,
    unused,
    unregistered,
)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_the_house_keeps_the_rule(rule: Callable[[House], list]) -> None:
    assert len(HOUSE.modules) > 100
    assert rule(HOUSE) == []


@pytest.mark.parametrize("rule", [too_long, private_across_folders], ids=lambda r: r.__name__)
@pytest.mark.parametrize("house", ALL[1:], ids=lambda house: house.package)
def test_what_stands_beside_it_keeps_the_rule(rule: Callable[[House], list], house: House) -> None:
    assert house.modules
    assert rule(house) == []


def test_at_most_three_see_everything() -> None:
    assert len(SEES_ALL) <= 3
    everything = {*ROOMS} - {"cli"}  # which only starts what the others do
    homes = {room(module) for module in HOUSE.modules}
    assert {home for home in homes if may_need(home) >= everything} == {*SEES_ALL}


def test_kernels_and_assets_import_nothing_from_gmdx() -> None:
    for house in (KERNELS, ASSETS):
        assert [told(i) for i in house.imports if i.target.split(".")[0] == "gmdx"] == []


def test_the_map_shows_the_rooms_in_their_order() -> None:
    text = (ROOT / "docs" / "house.md").read_text()
    shown = re.findall(r"^  (\w+)/ ", text, re.MULTILINE)
    assert shown == [name for name in ROOMS if (ROOT / "gmdx" / name).is_dir()]
    for family in families(HOUSE):
        assert f"{family.rpartition('.')[2]}/" in text, family


def built(root: Path, files: Mapping[str, str]) -> House:
    """A house of these files, with an empty door in every folder that has none."""
    for name, text in files.items():
        path = root / "gmdx" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    for folder in {root / "gmdx", *(p.parent for p in (root / "gmdx").rglob("*.py"))}:
        if not (folder / "__init__.py").exists():
            (folder / "__init__.py").touch()
    return House(root, "gmdx")


DOOR = '"""What it is."""\n\nfrom gmdx.trials.engines.{0} import {1}\n\n__all__ = ["{1}"]\n'
BAD: dict[str, tuple[Callable[[House], list], dict[str, str], object]] = {
    "an arrow back, deep in a function": (
        backward,
        {"scenes/settle.py": "def f():\n    from gmdx.trials import run\n", "trials/run.py": ""},
        ["gmdx.scenes.settle imports gmdx.trials.run"],
    ),
    "an arrow back, for types only": (
        backward,
        {
            "objects/box.py": "if TYPE_CHECKING:\n    from gmdx.metrics.table import METRICS\n",
            "metrics/table.py": "METRICS = ()\n",
        },
        ["gmdx.objects.box imports gmdx.metrics.table.METRICS"],
    ),
    "an arrow back, relative": (
        backward,
        {"files/formats.py": "from ..dataset.read import x\n", "dataset/read.py": "x = 1\n"},
        ["gmdx.files.formats imports gmdx.dataset.read.x"],
    ),
    "an arrow back, in a table of names": (
        backward,
        {"trials/registry.py": 'OPEN = {"a": "gmdx.studies.a"}\n', "studies/a.py": ""},
        ["gmdx.trials.registry imports gmdx.studies.a"],
    ),
    "the ground floor needs a room": (
        backward,
        {"rng.py": "import gmdx.files.formats\n", "files/formats.py": ""},
        ["gmdx.rng imports gmdx.files.formats"],
    ),
    "studies need the pipeline": (
        backward,
        {"studies/bias.py": "from gmdx.pipeline import generate\n", "pipeline/generate.py": ""},
        ["gmdx.studies.bias imports gmdx.pipeline.generate"],
    ),
    "two modules need each other": (
        round_trips,
        {
            "trials/a.py": "import gmdx.trials.b\n",
            "trials/b.py": "def f():\n    from gmdx.trials import c\n",
            "trials/c.py": "from gmdx.trials.a import x\n",
        },
        [["gmdx.trials.a", "gmdx.trials.b", "gmdx.trials.c"]],
    ),
    "a circle through a door": (
        round_trips,
        {
            "trials/run.py": "from gmdx.trials.engines.engine import Engine\n",
            "trials/engines/__init__.py": "from gmdx.trials.engines.mujoco import Mujoco\n",
            "trials/engines/mujoco.py": "from gmdx.trials.run import run\n",
            "trials/engines/engine.py": "",
        },
        [["gmdx.trials.engines", "gmdx.trials.engines.mujoco", "gmdx.trials.run"]],
    ),
    "two rooms need each other, no two modules do": (
        round_trips,
        {
            "grasps/a.py": "import gmdx.trials.b\n",
            "trials/b.py": "",
            "trials/c.py": "import gmdx.grasps.d\n",
            "grasps/d.py": "",
        },
        [["grasps", "trials"]],
    ),
    "too many lines": (
        too_long,
        {"cli/main.py": "x = 1\n" * (LONGEST + 1), "cli/terminal.py": "x = 1\n" * LONGEST},
        ["gmdx.cli.main: 331 lines"],
    ),
    "a private name of another folder": (
        private_across_folders,
        {
            "metrics/compute.py": "from gmdx.grasps.sample import _spread\n",
            "metrics/table.py": "from gmdx.metrics.compute import _row\n",
            "grasps/sample.py": "",
        },
        ["gmdx.metrics.compute imports gmdx.grasps.sample._spread"],
    ),
    "a name of a private module of another folder": (
        private_across_folders,
        {
            "metrics/quality.py": "from gmdx.metrics.epsilon._certify import NEAR_ZERO\n",
            "metrics/epsilon/_certify.py": "",
            "metrics/epsilon/many.py": "from gmdx.metrics.epsilon import _certify\n",
        },
        ["gmdx.metrics.quality imports gmdx.metrics.epsilon._certify.NEAR_ZERO"],
    ),
    "past a door": (
        past_doors,
        {
            "trials/run.py": "from gmdx.trials.engines.registry import choose\n",
            "pipeline/config.py": "from gmdx.trials.engines import choose\n",
            "trials/engines/__init__.py": DOOR.format("registry", "choose"),
            "trials/engines/registry.py": "from gmdx.trials.engines.mujoco import Mujoco\n",
            "trials/engines/mujoco.py": "",
        },
        ["gmdx.trials.run imports gmdx.trials.engines.registry.choose"],
    ),
    "a door that says nothing": (
        unsaid_doors,
        {"trials/engines/registry.py": "", "objects/model.py": ""},
        ["gmdx.trials.engines"],
    ),
    "a name that a door forgets to list": (
        unsaid_doors,
        {
            "trials/engines/__init__.py": DOOR.format("registry", "choose, open_engine"),
            "trials/engines/registry.py": "",
        },
        ["gmdx.trials.engines"],
    ),
    "a chart outside of pictures": (
        draws_elsewhere,
        {
            "studies/bias.py": "def f():\n    from matplotlib.lines import Line2D\n",
            "studies/types.py": "if TYPE_CHECKING:\n    from matplotlib.figure import Figure\n",
            "pictures/figure.py": "def f():\n    from matplotlib.figure import Figure\n",
        },
        ["gmdx.studies.bias imports matplotlib.lines.Line2D"],
    ),
    "no place, and an empty room": (
        without_place,
        {"tools/misc.py": "", "objects/model.py": "", "browser/__init__.py": ""},
        ["gmdx.tools", "gmdx.tools.misc", "gmdx.browser"],
    ),
    "a module that nothing needs": (
        unused,
        {
            "__init__.py": "if TYPE_CHECKING:\n    from gmdx.objects.model import ObjectModel\n",
            "objects/model.py": "from gmdx.objects.box import x\n",
            "objects/box.py": "",
            "objects/forgotten.py": "",
        },
        ["gmdx.objects.forgotten"],
    ),
    "an engine that its table does not name": (
        unregistered,
        {
            "trials/engines/registry.py": "def f():\n    from gmdx.trials.engines import mujoco\n",
            "trials/engines/mujoco.py": "",
            "trials/engines/drake/engine.py": "",
        },
        ["gmdx.trials.engines.drake", "gmdx.trials.engines.drake.engine"],
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_each_rule_sees_what_breaks_it(case: str, tmp_path: Path) -> None:
    rule, files, broken = BAD[case]
    assert rule(built(tmp_path, files)) == broken


def test_every_rule_has_a_case() -> None:
    assert {rule for rule, _, _ in BAD.values()} == {*RULES}


def test_a_sound_house_breaks_no_rule(tmp_path: Path) -> None:
    files = {
        "__init__.py": "if TYPE_CHECKING:\n    from gmdx.trials.run import run\n",
        "__main__.py": "from gmdx.cli.main import main\n",
        "errors.py": "",
        "cli/main.py": "def main():\n    from gmdx.trials.engines import choose\n",
        "trials/run.py": "from gmdx.errors import GmdxError\n",
        "trials/engines/__init__.py": DOOR.format("registry", "choose"),
        "trials/engines/registry.py": "def choose():\n    from gmdx.trials.engines import a\n",
        "trials/engines/a.py": "from gmdx.trials.run import run\n",
    }
    house = built(tmp_path, files)
    assert {rule.__name__: rule(house) for rule in RULES} == {r.__name__: [] for r in RULES}


def test_importing_gmdx_is_free_of_heavy_packages() -> None:
    heavy = ("numpy", "mujoco", "jax", "scipy", "trimesh", "coacd", "pyarrow", "matplotlib")
    code = f"import sys, gmdx, gmdx.cli.main; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_public_names_exist_and_are_listed() -> None:
    for name in gmdx.__all__:
        assert getattr(gmdx, name) is not None
    assert set(gmdx.__all__) <= set(dir(gmdx))
    wanted = {"load_object", "settle", "sample_grasps", "run_trials", "compute_metrics", "epsilon",
              "directional_strength", "generate", "read_dataset"}  # fmt: skip
    assert wanted <= set(gmdx.__all__)
    with pytest.raises(AttributeError, match="no attribute 'setle'"):
        gmdx.setle  # noqa: B018


@pytest.mark.parametrize("door", sorted(families(HOUSE)))
def test_doors_offer_what_they_list(door: str) -> None:
    try:
        module = import_module(door)
    except ModuleNotFoundError as error:
        if error.name not in ("pybullet", "warp"):
            raise
        pytest.skip(f"{error.name} is not installed")
    for name in module.__all__:
        # A function of a module's own name would hide the one or the other.
        assert f"{door}.{name}" not in HOUSE.modules
        assert getattr(module, name) is not None
