"""Checks and times of the governor: `python -m benchmarks.governor --help`."""

import argparse
from time import process_time

import numpy as np

from allocator import Limits
from allocator.units import BAR
from benchmarks.governor.closed_loop import COMMANDERS, DT, MACHINES, SLEW, closed_loop, governor_of, machine
from mpc.governor import GovernorStatus


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.governor", description=__doc__.partition(":")[0])
    parser.add_argument("--commands", type=int, default=1_000_000, help="adversarial ones")
    parser.add_argument("--arms", type=int, default=20, help="in each closed loop, 0 for none")
    parser.add_argument("--seconds", type=float, default=3.0, help="of each closed loop")
    arguments = parser.parse_args()
    if arguments.commands:
        adversarial(arguments.commands)
    if arguments.arms:
        loops(arguments.arms, arguments.seconds)
        gas(arguments.arms, arguments.seconds)
        unknown(arguments.arms, arguments.seconds)


def adversarial(N: int, chunk: int = 50_000) -> None:
    """Count broken limits and moved safe commands, for random states and commands of any size, some of them NaN."""
    arm, rng = machine("arm26", 0.02), np.random.default_rng(0)
    mechanism, governor = arm.mechanism, governor_of(arm, 0.0, ())
    if not governor.warm_up():
        raise SystemExit("numba cannot compile here; there is nothing to measure")
    broken = changed = 0
    time, counts = 0.0, dict.fromkeys(GovernorStatus, 0)
    for _ in range(N // chunk):
        q = rng.uniform(-1.0, 1.0, (chunk, 2))
        omega, P = rng.normal(0, 2, (chunk, 2)), rng.uniform(*mechanism.pressure_box(q))
        command = P + rng.choice([1e-2, 0.1, 1.0, 1e3], (chunk, 1)) * rng.normal(0, 1, P.shape) * BAR
        command[::20] = rng.choice([np.nan, np.inf, -np.inf, 1e300], command[::20].shape)
        begin = process_time()
        safe, status = governor.govern(q, omega, P, command)
        time += process_time() - begin
        lo, hi = mechanism.pressure_box(q, Limits(previous=P, max_step=SLEW * DT))
        broken += int(((safe < lo - 1e-3) | (safe > hi + 1e-3)).any(axis=1).sum())
        changed += int(((safe != command).any(axis=1) & (status == GovernorStatus.SAFE)).sum())
        for value, count in zip(*np.unique(status, return_counts=True), strict=True):
            counts[GovernorStatus(int(value))] += int(count)
    said = ", ".join(f"{count} {status.name}" for status, count in counts.items() if count)
    print(f"{N} commands: {broken} outside supply, slew or tautness; {changed} safe and moved; {said}")
    print(f"{time / N * 1e6:.1f} µs a command in batches, processor time", flush=True)


def loops(arms: int, seconds: float) -> None:
    """Measure the excursions beyond the range of arms equal to the model, with the governor and without."""
    print("machine  commander  lag [s]  beyond the range [°]  ungoverned  outside limits  not kept  moved")
    for name in MACHINES:
        for commander in COMMANDERS:
            for lag in (0.02, 0.1):
                r = closed_loop(name, commander, arms, seconds, lag=lag)
                free = closed_loop(name, commander, arms, seconds, lag=lag, governed=False)
                print(
                    f"{name:8} {commander:10} {lag:7} {np.degrees(r.beyond):21.2f} {np.degrees(free.beyond):11.1f} "
                    f"{r.broken:15} {r.unable:9.4f} {r.moved:6.3f}",
                    flush=True,
                )


def gas(arms: int, seconds: float) -> None:
    """Measure excursions of arms with gas in their muscles, of which the governor knows or does not."""
    print("machine  lag [s]  gas      not kept  with gas, beyond the range [°]: " + " ".join(COMMANDERS))
    for name in MACHINES:
        for lag in (0.02, 0.1):
            for known in ("unknown", "known"):
                runs = [closed_loop(name, each, arms, seconds, lag=lag, gas=known) for each in COMMANDERS]
                found = " ".join(f"{np.degrees(r.beyond):7.2f}" for r in runs)
                print(f"{name:8} {lag:7}  {known:7} {max(r.unable for r in runs):9.4f} {found}", flush=True)


UNKNOWN: tuple[dict[str, float], ...] = (
    {"damping": 0.1},
    {"damping": 0.2},
    {"mass": 0.2},
    {"lag": 0.3},
    {"strength": 0.1},
    {"strength": 0.1, "damping": 0.2, "mass": 0.1, "lag": 0.2},
)


def unknown(arms: int, seconds: float) -> None:
    """Measure excursions of random plants that differ from the model, with and without known intervals."""
    print("machine  within ±  intervals known  corners  beyond the range [°]: " + " ".join(COMMANDERS))
    for name in MACHINES[:2]:  # gravity leaves the leg no rest for these intervals
        for off in UNKNOWN if name == "joint" else UNKNOWN[-1:]:
            for told in (False, True):
                runs = [closed_loop(name, each, arms, seconds, off=off, told=told) for each in COMMANDERS]
                rules = governor_of(machine(name, 0.02), 0.0, tuple(off.items()) if told else ()).made.rules
                within = ", ".join(f"{quantity} {share:.0%}" for quantity, share in off.items())
                found = " ".join(f"{np.degrees(r.beyond):7.2f}" for r in runs)
                print(f"{name:8} {within}  {'yes' if told else 'no'} {len(rules.lag):8} {found}", flush=True)


if __name__ == "__main__":
    main()
