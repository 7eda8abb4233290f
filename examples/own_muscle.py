"""Fit a muscle to measured forces, put two of it on a joint, and ask for pressures."""

from pathlib import Path

from allocator import BAR, DEG, AntagonistJoint, Pulley, allocate
from allocator.identification import rank_models, read_samples

samples = read_samples(Path(__file__).parent / "force_table.csv")  # columns: contraction, pressure, force
ranking = rank_models(samples)
for fit in ranking.fits[:3]:
    print(f"{fit.model}: {fit.rms:.1f} N RMS")

best = ranking.best
joint = AntagonistJoint(Pulley(rest_length=0.4, radius=0.02, initial_contraction=0.1375), best.muscle, best.muscle)
a = allocate(10 * DEG, 5.0, 1.0, joint=joint)
print(f"{a.status.name}: P1 = {a.P1 / BAR:.3f} bar, P2 = {a.P2 / BAR:.3f} bar, K known to ± {a.K_std:.3f} N·m/rad")
