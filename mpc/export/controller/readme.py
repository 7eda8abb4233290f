"""README of the exported files."""

from allocator.joint.antagonist import AntagonistJoint
from mpc.export.controller.recursions import items_in
from mpc.export.controller.sizes import qp_iterations
from mpc.export.controller.tuning import tuning_numbers
from mpc.export.parts import BUILD, build_words
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
budget, `iteration_limit` bounds the solver behind the sweeps; 0 skips the QP, and the next rungs of the ladder answer.

The plant that it controls: {plant}.

Its weights, slack prices, slew limit and least force can be tuned while it runs, without a compiler:

    antagonist export tuning --out tuning.txt --errors theta=0.1,rate=0.3{options}

writes the {count} numbers of an `ant_tuning` (with the terminal cost of the weights). Give it the other options of this
export as well. `build/demonstration tuning.txt` shows their effect. On the board, pass them to `ant_tuning_from`, which
refuses those of another plant or sample time, and pass the tuning to `ant_tune` after `ant_reset` or between two steps.
N, the sample time, the supply, the joint range and the observer cannot be tuned.

The QP is solved sample by sample, as in Python (`src/recursions.c` is printed from the Python source): a sweep of
Riccati recursions starts from the slew bounds that were active in the last sample (two sweeps if the joint was thrown
aside), and one more pass computes the certificate. If the active set differs in a few bounds, these are exchanged one
after the other, each with two passes; that is the usual case where limits bind.
{rest}

Worst case of a step, counted from the bounds of the loops (N = {N}, {moves} moves, {rows} rows):

| | at most | usual |
|---|---|---|
| model over a sample | {stages} | {usual_stages} |
| its derivatives | {slopes} | {usual_slopes} |
| allocations | {allocations} | {allocations} |
| sweeps, backward and forward | {sweeps} | {qps} |
| exchanges of active bounds | {exchanges} | 0 to 10 |
{worst}
| Newton steps on the recursions, where the QP fails | {faces} | 0 |
{single}"""

_REST = {
    "double": """\
If this fails, an interior-point method on the same recursions solves the QP, with a certificate as well. Time and
memory grow with N, not with its cube.""",
    "single": """\
If this fails, the core of DAQP (`src/daqp`, MIT), a dual active-set method, solves the condensed QP
(`src/condense.c`), and its answer is checked before use: single precision has too few digits for an interior-point
method. Its time grows with the cube of N; at N = 20 such a step takes about ten times as long as the usual one. DAQP
receives only rows that an answer has violated, at most 4 N; if these do not suffice, the softened QP answers.""",
}

_WORST = {
    "double": "| iterations of the interior point, two Newton steps each | {iterations} | 0 to 10 |\n"
    "| rounds of the method of multipliers | {turns} | 0 to 5 |",
    "single": """\
| Givens rotations (2 to {rotation} multiplications each) in the condensing | {givens} | 0 |
| iterations of DAQP | {iterations} | 0 to 30 |""",
}

_CONTROL_SINGLE = """
In single precision commands differ by about 1e-5 of the supply. With costs of very different magnitude (weights much
sharper than `Weights.calm()`, and references far out of reach) the certificate refuses more answers of the QP than in
double precision; the softened QP then answers, with nearly the same commands.
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


def _control(controller: TrackingMPC, single: bool) -> str:
    from mpc.tracking.compiled.structured_qp.exchange import MORE
    from mpc.tracking.compiled.structured_qp.interior import MOST, SWEEPS
    from mpc.tracking.compiled.structured_qp.multipliers import TURNS

    N, blocks = controller.N, len(controller.problem.blocks)
    delay, qps, name = controller.ahead - N, controller.iterations, "single" if single else "double"
    moves = 2 * blocks
    worst = _WORST[name].format(
        givens=qps * (3 * (N - 1) + 2 * N + 6) * moves,
        rotation=4 * moves,
        turns=qps * TURNS * MOST,
        iterations=qps * qp_iterations(controller, single),
    )
    single_only = " --precision single" if single else ""
    return _CONTROL.format(
        options=single_only,
        count=2 + sum(values.size for _, values in tuning_numbers(controller, single)),
        dt=controller.dt,
        plant=controller.plant.summary,
        N=N,
        moves=moves,
        rows=6 * N,
        rest=_REST[name],
        sweeps=qps * (2 + (0 if single else SWEEPS * MOST)),
        qps=qps,
        exchanges=qps * (items_in(single) + N + MORE),
        worst=worst,
        stages=delay + qps * N + 5 * N,  # the dead time, every QP, every rung
        usual_stages=delay + (qps + 1) * N,
        slopes=qps * N + 4,  # the observer's, with one estimate per sensor that may repeat itself
        usual_slopes=qps * N + 1,
        allocations=N + 1,
        faces=10 * 4 * moves,
        single=_CONTROL_SINGLE if single else "",
    )
