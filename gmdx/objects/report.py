"""An object's report as plain lines for people."""

from typing import Any

from gmdx.objects.model import ObjectModel


def describe(obj: ObjectModel) -> str:
    """What was read, repaired and scaled, and how well the hulls stand for the surface.

    One fact a line; lengths in mm where they are of the prepared object.
    """
    report = obj.report
    source, surface, scaling = report["source"], report["surface"], report["scaling"]
    size = " x ".join(f"{x:.4g}" for x in source["size"])
    closed = "closed" if source["watertight"] else "not closed"
    lines = [
        f"{obj.object_id}",
        f"  source     {source['file']}: {source['triangles']} triangles, {closed}, "
        f"{size} in the file's unit",
    ]
    lines += [f"  repair     {_step(step)}" for step in report["repair"]]
    if not report["repair"]:
        lines.append("  repair     none needed")
    lines += [
        f"  scale      {obj.scale:.4g}; footprint {1e3 * scaling['footprint']:.1f} mm, "
        f"allowed {1e3 * scaling['max_footprint']:.1f} mm",
        f"  surface    {surface['triangles']} triangles, {surface['bodies']} separate parts, "
        f"{1e6 * surface['volume']:.4g} cm^3{_volume_ratio(surface['volume_ratio'])}",
        f"  box        {' x '.join(f'{1e3 * x:.1f}' for x in obj.box.extents)} mm",
        f"  mass       {obj.mass:g} kg, friction {obj.friction:g}",
        f"  rest       {len(obj.stable_poses.probabilities)} stable poses, the likeliest "
        f"{100 * obj.stable_poses.probabilities[0]:.0f} %",
        f"  hulls      {_hulls(obj)}",
    ]
    lines += [f"  warning    {warning}" for warning in report["warnings"]]
    seconds = sum(report["seconds"].values())
    lines.append(f"  time       {seconds:.1f} s of processor time when it was prepared")
    return "\n".join(lines)


def _step(step: dict[str, Any]) -> str:
    numbers = ", ".join(
        f"{key.replace('_', ' ')} {_number(value)}" for key, value in step.items() if key != "step"
    )
    return f"{step['step']}: {numbers}"


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _volume_ratio(ratio: float | None) -> str:
    return "" if ratio is None else f" ({ratio:.4f} of the source's)"


def _hulls(obj: ObjectModel) -> str:
    """How many hulls, and how far they and the surface are apart."""
    facts = obj.report["decomposition"]
    text = f"{len(obj.hulls)} with {sum(map(len, obj.hulls))} vertices by {facts['method']}"
    there, back = facts["hulls_to_surface_mm"]["p95"], facts["surface_to_hulls_mm"]["p95"]
    text += f"; 95 % within {there:.2f} mm of the surface, and back {back:.2f} mm"
    text += f"; volume {facts['volume_ratio']:.3f} of the surface's ({facts['kind']})"
    if not facts["within_bounds"]:
        text += f"; misses the bounds by {100 * facts['miss']:.0f} %"
    if facts.get("fallback") is not None:
        text += f"; fallback: {facts['fallback']}"
    return text
