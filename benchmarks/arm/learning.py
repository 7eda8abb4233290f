"""Learning to reach with postures and stiffnesses as actions, or with raw pressures. A baseline, 5 seeds each.

    python -m benchmarks.arm.learning [--seeds 5] [--generations 40] [--speed]

The learner is the cross-entropy method (R. Y. Rubinstein and D. P. Kroese, "The Cross-Entropy Method", 2004; in the
form of I. Szita and A. Lőrincz, "Learning Tetris using the noisy cross-entropy method", Neural Computation 18, 2006)
over a policy a = tanh(W s + b) of the observations, scaled to ±1: the same learner, sizes, episodes, pushes and
variation for both kinds of actions, starting from W = b = 0. Arms differ by 5 % in strength, 10 % in lag and mass, 30 %
in damping. The report has the mean return of the mean policy on 256 arms, postures and pushes unseen by all seeds, and
the error of the posture in the last half second, median and 90 % quantile; "not learned" is W = b = 0. `--speed`
measures the samples of the environments per second of a core's time instead.
"""

import argparse
from time import perf_counter, process_time
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.presentation.tables import number
from mpc.arm.learning.environment import ArmEnvironment, ArmVectorEnvironment
from mpc.arm.learning.task import Reaching, Task
from mpc.arm.learning.variation import Variation
from mpc.arm.learning.wiping import Wiping
from mpc.model.arm.model import Arm

POPULATION, ELITE, EPISODES, EXAMINED = 40, 8, 6, 256
SPREAD, NOISE = 0.3, 0.1  # of the first generation, and addition to the spread of later ones, falling to 0
UNSEEN = 10_000  # a separate seed
KINDS = "pressures", "posture-stiffness"


def task(actions: str) -> Reaching:
    variation = Variation(gains=0.05, lags=0.1, mass=0.1, damping=0.3)
    return Reaching(Arm.machine("arm26"), actions, dt=0.02, samples=100, variation=variation)


class Examined(NamedTuple):
    """Results of arms in an episode."""

    returned: Array  # of every arm (N,)
    error: Array  # in the last half second, mean over it (N,) [°]


def run(env: ArmVectorEnvironment, W: Array, seed: int) -> Examined:
    """Return the results of policies `W` (P, a, s + 1), each on an equal share of the arms, in one episode."""
    seen, _ = env.reset(seed=seed)
    low, high = env.single_observation_space.low, env.single_observation_space.high
    samples, late = env.episodes.task.samples, round(0.5 / env.episodes.task.dt)
    returned, error = np.zeros(env.num_envs), np.zeros(env.num_envs)
    for k in range(samples):
        s = (2 * seen - low - high) / (high - low)
        a = np.tanh(np.einsum("pas,pes->pea", W[..., :-1], s.reshape(len(W), -1, s.shape[1])) + W[:, None, :, -1])
        seen, reward, _, _, info = env.step(a.reshape(env.num_envs, -1))
        returned += reward
        error += info["error_rad"] * (k >= samples - late) / late
    return Examined(returned, np.rad2deg(error))


def learn(actions: str, seed: int, generations: int) -> Array:
    """Return the mean policy (a, s + 1) after `generations`."""
    env, rng = ArmVectorEnvironment(POPULATION * EPISODES, task(actions)), np.random.default_rng(seed)
    shape = env.single_action_space.shape[0], env.single_observation_space.shape[0] + 1
    mean, spread = np.zeros(shape), np.full(shape, SPREAD)
    for g in range(generations):
        W = mean + spread * rng.standard_normal((POPULATION, *shape))
        score = run(env, W, 1000 * (seed + 1) + g).returned.reshape(POPULATION, EPISODES).mean(axis=1)
        best = W[np.argsort(score)[-ELITE:]]
        mean, spread = best.mean(axis=0), best.std(axis=0) + NOISE * (1 - g / generations)
    return mean


def compare(seeds: int, generations: int) -> None:
    print(f"{generations} generations of {POPULATION} policies on {EPISODES} arms each")
    print("| actions | seed | return | median error at last [°] | 90 % [°] | seconds |\n|---|---|---|---|---|---|")
    for actions in KINDS:
        examiner = ArmVectorEnvironment(EXAMINED, task(actions))
        shape = examiner.single_action_space.shape[0], examiner.single_observation_space.shape[0] + 1
        found = []
        for seed in [-1, *range(seeds)]:
            begin = perf_counter()
            W = np.zeros(shape) if seed < 0 else learn(actions, seed, generations)
            result = run(examiner, W[None], UNSEEN)
            found.append(result.returned.mean())
            name, spent = "not learned" if seed < 0 else str(seed), perf_counter() - begin
            median, most = np.quantile(result.error, [0.5, 0.9])
            print(
                f"| {actions} | {name} | {number(found[-1])} | {number(median)} | {number(most)} | {spent:.0f} |",
                flush=True,
            )
        learned = np.array(found[1:])
        print(
            f"| {actions} | mean ± std | {number(learned.mean())} ± {number(learned.std(ddof=1))} | | | |", flush=True
        )


def speed() -> None:
    print("| task | machine | actions | dynamics | arms at a time | samples/s of a core |\n|---|---|---|---|---|---|")
    for kind, name in ((Reaching, "arm26"), (Wiping, "arm26"), (Reaching, "arm48")):
        for actions in KINDS:
            for dynamics, sizes in (("compiled", (1, 64, 512)), ("mujoco", (1,))):
                asked = kind(Arm.machine(name), actions, variation=task(actions).variation, dynamics=dynamics)
                for size in sizes:
                    rate = samples_per_second(asked, size)
                    told = f"{kind.__name__} | {name} | {actions} | {dynamics} | {size}"
                    print(f"| {told} | {rate:.0f} |", flush=True)


def samples_per_second(asked: Task, size: int) -> float:
    """Return the greatest rate of several stretches, in the time of one core, as the machine may be busy.

    A single arm has its own environment.
    """
    env = ArmEnvironment(asked) if size == 1 else ArmVectorEnvironment(size, asked)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(10)]
    env.step(actions[0])
    best = 0.0
    for _ in range(7):
        count, begin = 0, process_time()
        while process_time() - begin < 0.1:
            for action in actions:
                env.step(action)
            count += len(actions) * size
        best = max(best, count / (process_time() - begin))
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--generations", type=int, default=40)
    parser.add_argument("--speed", action="store_true")
    asked = parser.parse_args()
    if asked.speed:
        speed()
    else:
        compare(asked.seeds, asked.generations)


if __name__ == "__main__":
    main()
