"""`antagonist map` of several joints is answered here, in degrees and millimetres; behind it all is SI."""

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from allocator.errors import InvalidInput
from allocator.joint.gas import ISOBARIC, Stiffness
from allocator.joint.limits import Limits
from allocator.shell.hand_options import Hand, HandOptions, torques
from allocator.units import DEG

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from allocator.calculus import Array
    from allocator.mechanism.mechanism import Mechanism

_PLACES = 6, 5  # of the workspace, over shoulder and elbow
_SWING = 60 * DEG  # of joints without limits
_BENT = 5 * DEG  # from the stretched arm, at which the Jacobian is singular


def draw(
    mechanism: "Mechanism", options: HandOptions, targets: str | None, torque: str | None, *, min_force: float
) -> tuple["Figure", str, dict[str, object]]:
    """Return the figure of what a mechanism can do, a sentence on it, and what `--json` prints.

    At a posture the polygon of two `targets`, such as "K11,K22"; of a hand without a posture its stiffness ellipses
    over the workspace. `torque` is what is held: numbers [N·m], 0 by default, or "free". Raises `InvalidInput`.
    """
    hand = options.hand(mechanism)
    if options.posture is None and hand is not None and targets is None:
        return _workspace(mechanism, hand, torque, min_force)
    return _polygon(options, mechanism, hand, targets, torque, min_force)


def _polygon(
    options: HandOptions,
    mechanism: "Mechanism",
    hand: Hand | None,
    targets: str | None,
    torque: str | None,
    min_force: float,
) -> tuple["Figure", str, dict[str, object]]:
    from allocator.mechanism.feasibility import feasible_targets

    meant = ISOBARIC if hand is None else Stiffness(endpoint=hand.endpoint, force=hand.force)
    found = feasible_targets(mechanism, options.angles(mechanism), limits=Limits(min_force), stiffness=meant)
    x, y = _pair(targets, mechanism.n, hand)
    held = {} if torque == "free" else {f"T{i + 1}": float(T) for i, T in enumerate(torques(torque or "0", mechanism))}
    if hand is not None and held:
        pull = hand.endpoint.torque(found.q, hand.force)
        held = {name: T + float(pull[i]) for i, (name, T) in enumerate(held.items())}
    held = {name: T for name, T in held.items() if name not in (x, y)}
    polygon = found.polygon(x, y, held)
    binding = list(dict.fromkeys(limit for edge in polygon.edges for limit in edge.active))
    kept = f" at {polygon.held}" if polygon.held else ""
    sentence = f"{x} and {y}{kept}: {len(polygon.vertices)} corners; ended by: {', '.join(binding) or 'nothing exists'}"
    edges = [{"start": edge.start, "end": edge.end, "limits": edge.active} for edge in polygon.edges]
    return polygon.plot().figure, sentence, {"targets": [x, y], "held": held, "area": polygon.area, "edges": edges}


def _pair(targets: str | None, n: int, hand: Hand | None) -> tuple[str, str]:
    """Return the names of two targets; by default those of the first two joints, of the hand, or of a single joint."""
    if targets is None:
        targets = "Kx11,Kx22" if hand is not None else "K11,K22" if n > 1 else "T1,K11"
    names = targets.split(",")
    if len(names) != 2:
        raise InvalidInput(f"--targets {targets}: expected two with a comma between them, such as K11,K22 or T1,K12")
    return names[0], names[1]


def _workspace(
    mechanism: "Mechanism", hand: Hand, torque: str | None, min_force: float
) -> tuple["Figure", str, dict[str, object]]:
    from allocator.mechanism.feasibility import endpoint_ellipses

    if torque == "free":
        raise InvalidInput("the ellipses of a workspace are those of held torques; --torque free goes with --posture")
    T = torques(torque or "0", mechanism)
    q = _postures(mechanism, hand)
    found = endpoint_ellipses(mechanism, hand.endpoint, q, T, force=hand.force, limits=Limits(min_force))
    turns = np.degrees(found.tilt[..., 1] - found.tilt[..., 0])[found.exists]
    sentence = f"{len(q)} postures, torques exist at {int(found.exists.sum())}"
    if turns.size:
        sentence += f"; the ellipse turns by {turns.min():.0f}° to {turns.max():.0f}°"
    values: dict[str, object] = {"posture_deg": q / DEG, "position_m": found.x, "tilt_deg": np.degrees(found.tilt)}
    stiffness = {"softest_N_per_m": found.softest, "stiffest_N_per_m": found.stiffest}
    return found.plot().figure, sentence, values | stiffness


def _postures(mechanism: "Mechanism", hand: Hand) -> "Array":
    """Return postures (k, 2) [rad] over the range of both joints, without those at which the arm is stretched out."""
    if mechanism.n != 2:
        raise InvalidInput(f"the workspace is drawn of n = 2 joints, not {mechanism.n}; give a --posture")
    limits = mechanism.angle_limits or ((-_SWING, _SWING),) * 2
    every = np.array(list(product(*(np.linspace(*ends, count) for ends, count in zip(limits, _PLACES, strict=True)))))
    area = np.abs(np.linalg.det(hand.endpoint.jacobian(every)))
    return np.asarray(every[area > np.sin(_BENT) * area.max()])  # det J = l1 l2 sin of the angle between the links
