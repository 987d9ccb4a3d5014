"""What it costs, and what it changes, to take all contacts of a pad instead of their mean."""

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.stats import spearmanr

from gmdx.arrays import Array, Float
from gmdx.grasps.contact import closing_contacts
from gmdx.grasps.grasp import PadContacts
from gmdx.grasps.sample import sample_grasps
from gmdx.metrics.quality import PadSet, QualityConfig, pad_qualities
from gmdx.scenes.gripper import Gripper
from gmdx.scenes.scene import Scene
from gmdx.trials.run import run_trials


@dataclass(frozen=True)
class PatchFigures:
    """Qualities from all contacts of two pads against those of the pair of their means."""

    metric: str
    grasps: int  # with contact on both pads
    closure: float  # share of them with force closure, by all contacts
    closure_mean: float  # by the means
    ratio_median: float  # all / means, of grasps with closure by both
    ratio_least: float
    ratio_95_percent: float  # 95th percentile
    rank_correlation: float  # Spearman's, over all of these grasps
    milliseconds: float  # a grasp, processor time
    milliseconds_mean: float


def patch_figures(scenes: Iterable[Scene], *, grasps: int, gripper: Gripper) -> list[PatchFigures]:
    """Compare for metrics 15 (analytical contacts) and 23 (simulated ones).

    Args:
        scenes: Objects at rest.
        grasps: How many grasps of each.
        gripper: What grasps.

    Raises:
        GmdxError: The grasps could not be sampled or run.
    """
    found: dict[str, list[Float[Array, "2 n"]]] = {"real_d_quality": [], "real_s_quality": []}
    seconds = {name: np.zeros(2) for name in found}
    quality = QualityConfig().resolved()
    for scene in scenes:
        batch = sample_grasps(scene, grasps, gripper=gripper)
        trials = run_trials(scene, batch, gripper=gripper, trials=1)
        analytical = closing_contacts(scene, batch, gripper=gripper)
        sets = {"real_d_quality": analytical.pads, "real_s_quality": trials.contacts}
        for name, contacts in sets.items():
            contacts = contacts[contacts.both]
            values = []
            every, pair = (
                PadSet(contacts, quality.rtol_patch),
                PadSet(means(contacts), quality.rtol_pair),
            )
            for kind, pads in enumerate((every, pair)):
                start = time.process_time()
                values.append(_qualities(scene, pads, quality))
                seconds[name][kind] += time.process_time() - start
            found[name].append(np.stack(values))
    return [_figures(name, np.concatenate(v, axis=1), seconds[name]) for name, v in found.items()]


def means(contacts: PadContacts) -> PadContacts:
    """One contact a pad: the mean of its points, with the mean of their normals as its normal.

    Args:
        contacts: Of grasps with contact on both pads.
    """
    valid = contacts.valid[..., None]
    normal = np.where(valid, contacts.normals, 0.0).sum(axis=2)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return PadContacts(
        contacts.means[:, :, None], normal[:, :, None], np.ones((len(contacts), 2, 1), bool)
    )


def _qualities(scene: Scene, pads: PadSet, config: QualityConfig) -> Float[Array, "n"]:
    unaudited = np.zeros(len(pads.contacts), bool)
    found = pad_qualities({"quality": pads}, scene, audited=unaudited, config=config)
    return found.by_name["quality"].upper


def _figures(name: str, values: Float[Array, "2 n"], seconds: Float[Array, "2"]) -> PatchFigures:
    every, mean = values
    closed = (every > 0) & (mean > 0)
    ratio = every[closed] / mean[closed]
    low, middle, high = np.percentile(ratio, [0, 50, 95]) if closed.any() else np.full(3, np.nan)
    n = len(every)
    return PatchFigures(
        metric=name,
        grasps=n,
        closure=float((every > 0).mean()),
        closure_mean=float((mean > 0).mean()),
        ratio_median=float(middle),
        ratio_least=float(low),
        ratio_95_percent=float(high),
        rank_correlation=float(spearmanr(every, mean).statistic),
        milliseconds=1e3 * float(seconds[0]) / n,
        milliseconds_mean=1e3 * float(seconds[1]) / n,
    )
