"""README of the exported files."""

from allocator.joint.antagonist import AntagonistJoint
from mpc.export.controller.certificate import COMPILER, certificate
from mpc.export.controller.recursions import exchanges_in, items_in
from mpc.export.controller.tuning import tuning_numbers
from mpc.export.parts import BUILD, build_words, machine_words
from mpc.tracking.controller import TrackingMPC

_HEAD = (
    """\
# A pneumatic-muscle joint in C

Exported from the Python package `antagonist`, in {precision} precision, for: {joint}.
Plain C99 without a heap or global state; it needs only `math.h`, and every loop is bounded. Start with `antagonist.h`;
all units are SI. Generated for this joint: {written}.
The other files are the same for every joint.

"""
    + BUILD
    + """\

## Allocation

`ant_allocate` gives the pressures for a torque and a stiffness at an angle: the global optimum in closed form, as
`allocator.allocate(..., method="exact")` does. For invalid input (NaN, K <= 0, an angle beyond a turn) it returns
`ANT_BAD_INPUT` and pressures within the supply. {cost}
`ant_stiffness_at` gives the stiffness that a push of the joint meets at an angle and two pressures, term by term: the
slope of the backbone, the hysteresis at the amplitude of the push, and the trapped gas. The linker omits it where it is
not called.

{single}"""
)

_ARM = (
    """\
# An arm of pneumatic muscles in C

Exported from the Python package `antagonist`, in {precision} precision: {n} joints ({joints}), {m} muscles
({muscles}). Plain C99 without a heap or global state; it needs only `math.h`, and every loop is bounded. Start with
`antagonist.h`; all units are SI. Generated for this arm: `antagonist_config.h`, `src/mechanism.h`, `src/model.c`,
`src/recursions.c`, `src/settings.h`, `src/tables.c`, `src/demonstration.h`. The other files are the same for every arm.

"""
    + BUILD
    + """\

## Allocation

`ant_allocate` gives the pressures for torques and a stiffness at a posture, or the nearest that the limits allow, as
`allocator.allocate` does.
"""
)

_COST = {
    "tondu": """A call costs at most 7 square roots, about 40
divisions and 4 steps of Newton's method; there is no other loop.
""",
    "affine": """A call costs one evaluation of the
joint's formulas (`src/model.c`) and about a dozen operations; there is no loop.
""",
}

_SINGLE = """
In single precision the pressures differ from those of double precision by about 1e-6 of the supply. The difference is
greater where torque and stiffness hardly depend on the pressures (a lever near its dead point), but the resulting
torque and stiffness differ by no more.
"""

_CONTROL = """
## Control

`ant_step` is a whole step of `mpc.TrackingMPC` behind `mpc.KalmanObserver`, with the same statuses and rungs: observer,
disturbance torque, dead time, friction and dead band, references brought within reach, the QP, its certificate, the
fallback ladder and the limits. Call `ant_reset` once and `ant_step` every {dt:g} s; send `plan.u[0]`. Pass NaN for a
missing sensor reading. All memory is in `ant_controller`, which should be static. There is no clock: instead of a time
budget, `exchange_limit` bounds the exchanges of a QP, and `ANT_EXCHANGES` bounds them at compile time. At the bound
the commands are within slew and supply, `plan.status` is `ANT_PLAN_UNSOLVED`, and `plan.gap` bounds their
suboptimality (primal cost minus dual cost).

The plant that it controls: {plant}.

Its weights, slack prices, slew limit and least force can be tuned while it runs, without a compiler:

    antagonist export tuning --out tuning.txt --errors theta=0.1,rate=0.3

writes the {count} numbers of an `ant_tuning` (with the terminal cost of the weights). Give it the other options of this
export as well. `build/demonstration tuning.txt` shows their effect. On the board, pass them to `ant_tuning_from`, which
refuses those of another plant or sample time, and pass the tuning to `ant_tune` after `ant_reset` or between two steps.
N, the sample time, the supply, the joint range and the observer cannot be tuned.

The QP is solved sample by sample, as in Python (`src/recursions.c` is printed from the Python source): a sweep of
Riccati recursions starts from the slew and supply limits that were active in the last sample, and one more pass
computes the certificate. If the active set differs, limits are exchanged one after the other, each with two passes (the
dual active-set method of Goldfarb and Idnani); a new sweep takes the set if more than {items} limits differ. After
{patience} exchanges, up to {turns} sweeps of a barrier method propose another set. Time and memory grow with N, not
with its cube.

Worst case of a step, counted from the bounds of the loops (N = {N}, {moves} moves, {rows} rows):

| | at most | usual |
|---|---|---|
| model over a sample | {stages} | {usual_stages} |
| its derivatives | {slopes} | {usual_slopes} |
| allocations | {allocations} | {allocations} |
| sweeps, backward and forward | {sweeps} | {qps} |
| exchanges of active limits | {exchanges} | 0 to 10 |
| multiplications and divisions of a QP | {begin} + {exchange} per exchange | {plain} per exchange without a new sweep |
| stack of `ant_step` | {stack} bytes | |

All bounds but that of the stack are theoretical: they are counted from the loops and hold for any input. The bound of
the exchanges is `ANT_EXCHANGES`, {each} per move and QP. A smaller one in `antagonist_config.h` lowers `ANT_QP_SWEEPS`
and `ANT_QP_MULTIPLICATIONS`. Most exchanges need no new sweep.

The stack was measured with {compiler} at `-Os` and `-O2`, without C library and interrupts. `ANT_STACK` is a
formula of the sizes that is above all measured stacks; without optimisation more is used. `-fcallgraph-info=su`
measures yours.

The greatest numbers that a search (`python -m benchmarks.speed.worst_cases`) has found are in
`benchmarks/results/worst_cases.md` of the package's sources.
{single}"""

_CONTROL_SINGLE = """
In single precision commands differ by about 1e-5 of the supply. With costs of very different magnitude (weights much
sharper than `Weights.calm()`, and references far out of reach) some answers of the QP are not proved, unlike in double
precision, with nearly the same commands.
"""


def readme(
    joint: AntagonistJoint, kernel: str, single: bool, printed: list[str], controller: TrackingMPC | None = None
) -> str:
    """Return the README; `printed` is the expected output of the demonstration, computed in Python."""
    muscles = " and ".join(type(muscle).__name__ for muscle in (joint.agonist, joint.antagonist))
    written = ["antagonist_config.h", "src/joint.h", "src/stiffness_model.c", "src/demonstration.h"]
    written += ["src/model.c"] if kernel == "affine" or controller else []
    written += ["src/settings.h", "src/tables.c"] if controller else []
    head = _HEAD.format(
        **build_words(single, printed),
        joint=f"{muscles} on a {type(joint.geometry).__name__}",
        written=", ".join(f"`{name}`" for name in written),
        single=_SINGLE if single else "",
        cost=_COST[kernel],
    )
    return head if controller is None else head + _control(controller, single)


def arm_readme(controller: TrackingMPC, single: bool, printed: list[str]) -> str:
    """Return the README of an arm's controller; `printed` is the expected output of the demonstration."""
    head = _ARM.format(**build_words(single, printed), **machine_words(controller.plant.mechanism))
    return head + _control(controller, single)


def _control(controller: TrackingMPC, single: bool) -> str:
    from mpc.tracking.compiled.structured_qp.barrier import TURNS
    from mpc.tracking.compiled.structured_qp.exchange import CROWDED
    from mpc.tracking.compiled.structured_qp.solve import PATIENCE

    N, blocks = controller.N, len(controller.problem.blocks)
    delay, qps = controller.ahead - N, controller.iterations
    n, m, bounds = controller.plant.n, controller.plant.m, certificate(controller, single)
    moves = m * blocks
    return _CONTROL.format(
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
        single=_CONTROL_SINGLE if single else "",
    )
