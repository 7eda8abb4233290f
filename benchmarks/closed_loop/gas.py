"""Gas in the muscles: the cost of ignoring it, and the stiffness felt by a hand.

    python -m benchmarks.closed_loop.gas [--out benchmarks/results]

The plant is the report's joint with Sarosi's muscles, lag 0.1 s, and gas with κ = 1.3. The references are sines of 20°
at constant stiffness; the angle's error is taken between the ramps. "Muscles 5 % off" have 1.05 and 0.95 times the
modelled forces. Observers measure angle and pressures, no velocity. The real plant is the standard one of the
closed-loop benchmark (muscles 10 % off, hysteresis, dead time, dead band, noise), with gas. Pushes are those of
`benchmarks.closed_loop.push`, inside and outside a dead band of 0.15 bar. The output is `gas.md`.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from benchmarks.closed_loop.push import Felt, Shake, felt
from mpc import KalmanObserver, Plant, RealPlant, Reference, Run, TrackingMPC, Weights, simulate, sine
from mpc.trials.loops import Settings, loop
from mpc.trials.simulation import Process

JOINT = report_joint(SAROSI_DMSP_20_400N)
K, AMPLITUDE, RAMP = 7.6, 20 * DEG, 2.0  # [N·m/rad], [rad], [s]
FREQUENCIES = 0.25, 0.5, 1.0  # [Hz] of the sines
PUSHED, AT, BAND = (0.05, 0.5, 2.0, 20.0), 3 * BAR, 0.15 * BAR  # [Hz], [Pa] in both muscles, [Pa]
OFF = 1.05, 0.95  # times the modelled force
ROUNDS = 5  # of timed runs


class Case(NamedTuple):
    """Plant, and the controller's model of it."""

    name: str
    process: Process
    model: Plant
    observed: bool


def cases(joint: AntagonistJoint = JOINT) -> list[Case]:
    bare, gas = Plant(joint, gas=False), Plant(joint)
    off = RealPlant(gas, OFF)
    return [
        Case("no gas", bare, bare, observed=False),
        Case("gas unknown", gas, bare, observed=False),
        Case("gas unknown, observer", gas, bare, observed=True),
        Case("gas known", gas, gas, observed=False),
        Case("gas unknown, muscles 5 % off, observer", off, bare, observed=True),
        Case("gas known, muscles 5 % off, observer", off, gas, observed=True),
    ]


def tracked(case: Case, frequency: float, duration: float = 8.0) -> Run:
    reference = sine(AMPLITUDE, frequency, K, K_amplitude=0.0, duration=duration, ramp=RAMP)
    observer = KalmanObserver(case.model, 0.01) if case.observed else None
    return simulate(case.process, TrackingMPC(case.model), reference, observer=observer)


def on_the_real_plant(controller: str, model: Plant, frequency: float) -> float:
    """Return the RMS of the angle's error [°] of a loop with the model `model`."""
    real = RealPlant.standard(nominal=Plant(JOINT, lag=0.12))
    driver, observer = loop(controller, Settings(model, compensation=real.known(), weights=Weights.calm()))
    reference = sine(AMPLITUDE, frequency, 5.5, K_amplitude=0.0, duration=8.0, ramp=RAMP)
    return error(simulate(real, driver, reference, observer=observer, seed=3))


def error(run: Run) -> float:
    """Return the RMS of the angle's error between the ramps [°]."""
    ramp = round(RAMP / run.dt)
    return float(np.sqrt(np.mean((run.theta - run.theta_ref)[ramp:-ramp] ** 2)) / DEG)


def pushed(frequency: float, dead_band: float = 0.0, angle: float = 1 * DEG) -> Felt:
    """Return the stiffness felt at 3 bar, θ = 0; the push stays inside the dead band, if any."""
    plant = Plant(JOINT)
    real = RealPlant(plant, dead_band=dead_band)
    x = np.array([0.0, 0.0, AT, AT])
    rest = Reference([0.0, 1.0], [0.0, 0.0], [float(plant.stiffness(x))] * 2)
    return felt(real, plant, (TrackingMPC(plant), KalmanObserver(plant, 0.01)), rest, 1.0, Shake(frequency, angle))


def trapped(found: Felt) -> float:
    """Return the stiffness with all of the gas trapped at the state of the push [N·m/rad]."""
    x = np.array([found.theta, 0.0, *found.P])
    return found.isobaric + float(sum(RealPlant(Plant(JOINT)).trapped(x)))


def step_times(joint: AntagonistJoint) -> tuple[float, float]:
    """Return the median times of a step without and with gas in the model, the least of some rounds [µs]."""
    reference = sine(AMPLITUDE, 1.0, K, duration=4.0, ramp=1.0)
    plants = Plant(joint, gas=False), Plant(joint)
    controllers = [TrackingMPC(plant) for plant in plants]
    pairs = [*zip(plants, controllers, strict=True)]
    rounds = [[1e6 * float(np.median(simulate(*pair, reference).step_time)) for pair in pairs] for _ in range(ROUNDS)]
    without, with_gas = np.min(rounds, axis=0).tolist()
    return without, with_gas


def markdown() -> Iterator[str]:
    assert __doc__ is not None
    yield "# " + __doc__.splitlines()[0] + "\n"
    yield __doc__.partition("\n\n")[2].partition("\n\n")[2]
    yield "\n## RMS error of the angle [°]\n"
    yield "| model and loop | " + " | ".join(f"{f:g} Hz" for f in FREQUENCIES) + " |"
    yield "|---" * (1 + len(FREQUENCIES)) + "|"
    for case in cases():
        yield f"| {case.name} | " + " | ".join(f"{error(tracked(case, f)):.2g}" for f in FREQUENCIES) + " |"
    yield "\n## The same on the real plant, muscles and all\n"
    yield "| controller | model | " + " | ".join(f"{f:g} Hz" for f in FREQUENCIES) + " |"
    yield "|---" * (2 + len(FREQUENCIES)) + "|"
    for name in ("mpc", "lqr", "pid"):
        for has in (False, True):
            model = Plant(JOINT, lag=0.12, gas=has)
            errors = " | ".join(f"{on_the_real_plant(name, model, f):.2f}" for f in FREQUENCIES)
            yield f"| {name} | {'with' if has else 'without'} gas | {errors} |"
    yield "\n## Stiffness felt [N·m/rad]: storage + i loss\n"
    yield "| [Hz] | dead band | pushed | by the formula | off by [%] |\n|---|---|---|---|---|"
    for band in (0.0, BAND):
        for f in PUSHED:
            found = pushed(f, band)
            wanted = complex(trapped(found)) if band else found.expected
            off = 100 * abs(found.measured - wanted) / abs(wanted)
            yield f"| {f:g} | {band / BAR:g} bar | {_said(found.measured)} | {_said(wanted)} | {off:.2g} |"
    yield "\n## Time of a compiled step [µs]\n"
    yield "| muscles | without gas | with gas | ratio |\n|---|---|---|---|"
    for name, joint in (("Sarosi2012", JOINT), ("Tondu2021", report_joint())):
        without, with_gas = step_times(joint)
        yield f"| {name} | {without:.1f} | {with_gas:.1f} | {with_gas / without:.2f} |"


def _said(K: complex) -> str:
    return f"{K.real:.4f} + {K.imag:.4f}i".replace("+ -", "- ")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "results")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    lines = []
    for line in markdown():
        print(line, flush=True)
        lines.append(line)
    (given.out / "gas.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
