"""README of the exported files."""

from allocator.joint.antagonist import AntagonistJoint
from mpc.export.controller.certificate import COMPILER, certificate
from mpc.export.controller.recursions import exchanges_in, items_in
from mpc.export.controller.tuning import tuning_numbers
from mpc.export.parts import build_words, filled, machine_words
from mpc.tracking.controller import TrackingMPC

_COST = {
    "tondu": """A call costs at most 7 square roots, about 40
divisions and 4 steps of Newton's method; there is no other loop.
""",
    "affine": """A call costs one evaluation of the
joint's formulas (`src/model.c`) and about a dozen operations; there is no loop.
""",
}


def readme(
    joint: AntagonistJoint, kernel: str, single: bool, printed: list[str], controller: TrackingMPC | None = None
) -> str:
    """Return the README; `printed` is the expected output of the demonstration, computed in Python."""
    muscles = " and ".join(type(muscle).__name__ for muscle in (joint.agonist, joint.antagonist))
    written = ["antagonist_config.h", "src/joint.h", "src/stiffness_model.c", "src/demonstration.h"]
    written += ["src/model.c"] if kernel == "affine" or controller else []
    written += ["src/settings.h", "src/tables.c"] if controller else []
    head = filled(
        "joint",
        **build_words(single, printed),
        joint=f"{muscles} on a {type(joint.geometry).__name__}",
        written=", ".join(f"`{name}`" for name in written),
        single=filled("single") if single else "",
        cost=_COST[kernel],
    )
    return head if controller is None else head + _control(controller, single)


def arm_readme(controller: TrackingMPC, single: bool, printed: list[str]) -> str:
    """Return the README of an arm's controller; `printed` is the expected output of the demonstration."""
    head = filled("arm", **build_words(single, printed), **machine_words(controller.plant.mechanism))
    return head + _control(controller, single)


def _control(controller: TrackingMPC, single: bool) -> str:
    from mpc.tracking.compiled.structured_qp.barrier import TURNS
    from mpc.tracking.compiled.structured_qp.exchange import CROWDED
    from mpc.tracking.compiled.structured_qp.solve import PATIENCE

    N, blocks = controller.N, len(controller.problem.blocks)
    delay, qps = controller.ahead - N, controller.iterations
    n, m, bounds = controller.plant.n, controller.plant.m, certificate(controller, single)
    moves = m * blocks
    return filled(
        "control",
        count=2 + sum(values.size for _, values in tuning_numbers(controller)),
        dt=controller.dt,
        plant=controller.plant.summary,
        N=N,
        moves=moves,
        items=min(CROWDED, items_in(n, m, blocks, single) - 2),
        patience=PATIENCE,
        turns=TURNS,
        each=exchanges_in(1),
        rows=2 * (n + m) * N,
        sweeps=qps * bounds.sweeps,
        qps=qps,
        exchanges=qps * bounds.exchanges,
        **{name: getattr(bounds, name) for name in ("begin", "exchange", "plain", "stack")},
        compiler=COMPILER,
        stages=delay + qps * N + 5 * N,  # the dead time, every QP, every rung
        usual_stages=delay + (qps + 1) * N,
        slopes=qps * N + 4,  # the observer's, with one estimate per sensor that may repeat itself
        usual_slopes=qps * N + 1,
        allocations=N + 1,
        single=filled("single_control") if single else "",
    )
