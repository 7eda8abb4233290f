"""Ready-made machines, each with the source of its numbers.

All have pulleys and Festo DMSP-20-400N muscles (Sárosi et al. 2012) with rest length 40 cm and 0–5 bar; to adapt them
use `dataclasses.replace` and `Mechanism.with_muscles`.
"""

from collections.abc import Callable, Mapping

from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.routes import Pulleys
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import DEG

_REST_LENGTH = 0.40  # [m]
_CONTRACTION = 0.1375  # ε0 of all muscles in the middle posture, as on the report's joint   (25)


def _on_pulleys(joints: tuple[tuple[str, float], ...], muscles: Mapping[str, tuple[float, ...]]) -> Mechanism:
    """Return a mechanism from (name, range [°] to both sides) of the joints and arms [m] of the muscles by name."""
    return Mechanism(
        Pulleys(_REST_LENGTH, list(muscles.values()), _CONTRACTION),
        (SAROSI_DMSP_20_400N,) * len(muscles),
        angle_limits=tuple((-reach * DEG, reach * DEG) for _, reach in joints),
        muscle_names=tuple(muscles),
        joint_names=tuple(name for name, _ in joints),
    )


def arm26() -> Mechanism:
    """Return a two-link arm in the plane with two muscles at each joint and two biarticular ones: n = 2, m = 6.

    The arrangement is that of the human arm's six muscle groups (Hogan 1985, "The mechanics of multi-joint posture and
    movement control", Biol. Cybern. 52); pulleys of 2 cm as the report's, the biarticular muscles with 1.5 cm at the
    elbow. Without them K12 = 0 on pulleys.
    """
    r, s = 0.02, 0.015
    return _on_pulleys(
        (("shoulder", 60.0), ("elbow", 60.0)),
        {
            "shoulder flexor": (r, 0.0),
            "shoulder extensor": (-r, 0.0),
            "elbow flexor": (0.0, r),
            "elbow extensor": (0.0, -r),
            "biarticular flexor": (r, s),
            "biarticular extensor": (-r, -s),
        },
    )


def arm48() -> Mechanism:
    """Return an arm with four joints and an antagonistic pair of muscles at each: n = 4, m = 8.

    The arrangement is that of the arm of D. Büchler, H. Ott and J. Peters, "A Lightweight Robotic Arm with Pneumatic
    Muscles for Robot Learning", ICRA 2016; pulleys and muscles are the report's, not theirs.
    """
    names = "base", "shoulder", "elbow", "wrist"
    arms = {}
    for i, name in enumerate(names):
        for sign, kind in ((0.02, "flexor"), (-0.02, "extensor")):
            arms[f"{name} {kind}"] = tuple(sign if i == j else 0.0 for j in range(len(names)))
    return _on_pulleys(tuple((name, 90.0) for name in names), arms)


def leg37() -> Mechanism:
    """Return a leg in the plane, hip, knee and ankle, with seven muscles of which two are biarticular: n = 3, m = 7.

    Muscles and the ratios of their moment arms are those of H. Geyer and H. Herr, "A Muscle-Reflex Model That Encodes
    Principles of Legged Mechanics", IEEE Trans. Neural Syst. Rehabil. Eng. 18(3), 2010 (10, 10, 8/5, 6, 5/5, 5 and 4
    cm), times 0.4 to suit the muscles' stroke. Angles grow with flexion of hip and knee and with dorsiflexion.
    """
    c = 0.004  # 0.4 of a centimetre [m]
    return _on_pulleys(
        (("hip", 40.0), ("knee", 40.0), ("ankle", 40.0)),
        {
            "hip flexors": (10 * c, 0.0, 0.0),
            "glutei": (-10 * c, 0.0, 0.0),
            "hamstrings": (-8 * c, 5 * c, 0.0),
            "vasti": (0.0, -6 * c, 0.0),
            "gastrocnemius": (0.0, 5 * c, -5 * c),
            "soleus": (0.0, 0.0, -5 * c),
            "tibialis anterior": (0.0, 0.0, 4 * c),
        },
    )


MACHINES: Mapping[str, Callable[[], Mechanism]] = {"arm26": arm26, "arm48": arm48, "leg37": leg37}
"""Every ready-made machine, by its name."""
