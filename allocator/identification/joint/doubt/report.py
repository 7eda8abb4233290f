"""The doubt of a joint's fit is put into words and into the values of `--json` here."""

from typing import TYPE_CHECKING

import numpy as np

from allocator.identification.joint.doubt.covariance import Choice
from allocator.units import DEG

if TYPE_CHECKING:
    from allocator.identification.joint.result import JointFit


def found_std(fit: "JointFit") -> dict[str, float]:
    """Return how far ratio [-], zero [rad] and friction [-] of a `JointFit` are known; 0 for what was not fitted."""
    std = fit.standard_deviations
    found = {name: std.get(name, 0.0) for name in ("zero", "friction")}
    return found | {"ratio": fit.ratio * std.get("log_ratio", 0.0)}


def choice_lines(fit: "JointFit") -> list[str]:
    """Return a line on each other choice of a `JointFit`, and one on laws that predict the angles better."""
    K = "K/K_ref" if fit.scale is None else "K"
    lines = [
        f"with {c.name} instead: {c.rms / DEG:.2f}°, zero {c.zero / DEG:+.2f}°, ratio {c.ratio:.3f}, "
        f"μ = {c.friction:.3f}, {K} other by {c.stiffness:.1%}"
        for c in fit.doubt.choices
    ]
    better = [c.name for c in fit.doubt.choices if c.kind == "law" and c.rms < 0.8 * fit.rms]
    return lines + ([f"{' and '.join(better)} predict(s) these angles better: try --model"] if better else [])


def choice_values(choice: Choice) -> dict[str, object]:
    """Return what `--json` prints of a choice."""
    return {
        "choice": choice.name,
        "kind": choice.kind,
        "rms_deg": choice.rms / DEG,
        "encoder_zero_deg": choice.zero / DEG,
        "antagonist_over_agonist": choice.ratio,
        "friction": choice.friction,
        "stiffness_change": choice.stiffness if np.isfinite(choice.stiffness) else None,
    }
