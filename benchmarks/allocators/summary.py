"""Summary figures of the comparison, and their formats."""

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.allocators.comparison import Results
from benchmarks.allocators.contenders import BACK_ENDS, CONTENDERS
from benchmarks.allocators.measures import Score
from benchmarks.allocators.warm_start import Gain

NOTHING = 1e-5  # [N·m], [N·m/rad] smaller errors are written as below it
HEADER = (
    "",
    "allowed: Fig. 8",
    "allowed: random",
    "T lost: Fig. 8",
    "T lost: random",
    "K missed: Fig. 8",
    "failed",
    "time",
)
EXPLAINED = (
    "Torque first. Allowed: answers within all limits, on Fig. 8 and on the random sets. T lost: torque error where "
    "the torque is feasible, RMS (worst) [N·m]. K missed: worst stiffness error [N·m/rad]. Failed: solver failures. "
    "Time: of a batch, in multiples of exact."
)


def summary(results: Results) -> Iterator[tuple[str, ...]]:
    """Return one row per contender: Fig. 8, and the random sets of all joints together."""
    for contender in CONTENDERS:
        mine = [s for s in results.scores if s.contender == contender.name and s.priority == "torque"]
        report, random = ([s for s in mine if s.set == name] for name in ("Fig. 8", "random"))
        yield (
            contender.name,
            percent(mean([s.within_limits for s in report])),
            percent(mean([s.within_limits for s in random])),
            torque_error(report),
            torque_error(random),
            number(max(s.K_worst for s in report)),
            percent(mean([s.solver_failed for s in mine])),
            digits(np.median([t.ratio for t in results.times if t.contender == contender.name])),
        )


def torque_error(scores: Sequence[Score]) -> str:
    """Return RMS (worst) with a feasible torque, over several sets."""
    squares = [s.T_rms_reachable**2 * s.torque_reachable for s in scores]
    rms = float(np.sqrt(sum(squares) / sum(s.torque_reachable for s in scores)))
    return error(rms, max(s.T_worst_reachable for s in scores))


def findings(results: Results) -> Iterator[str]:
    """Yield findings of the tables, in sentences."""
    by = {(s.set, s.joint, s.priority, s.contender): s for s in results.scores}
    report = results.sets[0]
    raw, clipped, cut, exact = (
        by[report.name, report.joint_name, "torque", name] for name in [c.name for c in CONTENDERS[:4]]
    )
    yield (
        f"On the ranges of Fig. 8 **{percent(1 - raw.within_limits)}** of the inverse's answers break a pressure limit "
        f"or slacken a cable ({percent(1 - raw.taut)} slacken one); of the allocators' answers none does."
    )
    yield (
        f"All torques are feasible there. The clipped inverse loses up to **{clipped.T_worst_reachable:.2f} N·m** of it"
        f" (clipped to all limits, in the box: {cut.T_worst_reachable:.2f} N·m), the allocators "
        f"{number(exact.T_worst_reachable)} N·m: they give up stiffness instead, as little as possible."
    )
    random = [s for k, s in by.items() if k[0] == "random" and k[2:] == ("torque", clipped.contender)]
    lost = np.average([s.T_lost_reachable for s in random], weights=[s.torque_reachable for s in random])
    yield (
        f"On the random targets the clipped inverse loses more than 1 % of the joint's greatest torque at "
        f"**{percent(float(lost))}** of the targets with a feasible torque; the worst loss is "
        f"{max(s.T_worst_reachable for s in random):.1f} N·m."
    )
    proved = [s for s in results.scores if s.contender in [b.name for b in BACK_ENDS]]
    yield (
        f"The back-ends agree with `exact` within {max(s.distance_to_exact for s in proved):.0e} of the supply range. "
        f"On no set do more than {percent(max(s.solver_failed for s in proved))} of their answers fail (status "
        "SOLVER_FAILED, with the exact answer), or more than "
        f"{percent(max(s.worse_than_exact for s in proved))} end in a local optimum worse than `exact`."
    )
    feasible = [g for g in results.gains if g.set == "feasible"]
    mixed = [g for g in results.gains if g.set == "random"]
    yield (
        f"The warm start needs {mean([g.iterations_warm for g in feasible]):.2g} instead of "
        f"{mean([g.iterations_cold for g in feasible]):.2g} iterations on feasible targets, "
        f"{mean([g.iterations_warm for g in mixed]):.2g} instead of "
        f"{mean([g.iterations_cold for g in mixed]):.2g} on mixed ones (mean over back-ends and joints)."
        f"{''.join(dearer(results.gains))}"
    )


def dearer(gains: Sequence[Gain]) -> Iterator[str]:
    """Return the sets on which the warm start costs iterations."""
    for g in gains:
        if g.iterations_warm > g.iterations_cold:
            yield (
                f" It costs {g.back_end} iterations on {g.set}, {g.joint}: {g.iterations_warm:.3g} instead of "
                f"{g.iterations_cold:.3g}."
            )


def mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def percent(share: float) -> str:
    """Return a share; 100 % and 0 % are written only if exact."""
    text = f"{100 * share:.1f} %"
    if share not in (0.0, 1.0):
        return {"0.0 %": "< 0.1 %", "100.0 %": "> 99.9 %"}.get(text, text)
    return text.replace(".0", "")


def digits(value: float) -> str:
    """Return three digits, no exponent."""
    return f"{value:.3g}" if value < 1000 else f"{value:.0f}"


def number(value: float) -> str:
    """Return an error, or the bound `NOTHING` for smaller ones."""
    return f"< {NOTHING:.0e}".replace("e-0", "e-") if value < NOTHING else f"{value:.3g}"


def error(rms: float, worst: float) -> str:
    return number(worst) if worst < NOTHING else f"{number(rms)} ({number(worst)})"
