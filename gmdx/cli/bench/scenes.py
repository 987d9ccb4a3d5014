"""Objects at rest, for measurements on them."""

from collections.abc import Iterator, Sequence

from gmdx.cli.terminal import following
from gmdx.machine.progress import Follower
from gmdx.objects.prepare import prepare
from gmdx.objects.sources import resolve
from gmdx.scenes.scene import Scene
from gmdx.scenes.settle import settle


def fresh_scenes(objects: Sequence[str]) -> Iterator[Scene]:
    """One scene of each object, which is prepared without a cache."""
    for source in resolve(objects):
        yield settle(prepare(source, cache=None))


def prepared_scenes(objects: Sequence[str]) -> list[Scene]:
    """One scene of each object; what was prepared before comes from the user's cache."""
    sources = resolve(objects)
    scenes = []
    with following("objects") as show:
        follower = Follower(len(sources), show)
        for source in sources:
            scenes.append(settle(prepare(source)))
            follower.finished(source.object_id, count=1)
    return scenes
