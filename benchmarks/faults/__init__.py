"""Faults of a joint, and their diagnosis by its observer.

The loop is that of the closed-loop benchmark: MPC and observer with the nominal model of Sarosi's muscles, dead time,
dead band and a share of the friction. Every fault comes at several moments, in the rest before the motion and in the
motion, and lasts for the rest of the run, `AFTERWARDS` seconds at most. Without a fault nothing may be suspected, for
any trajectory, plant (strength of the muscles, lag, assumed but absent friction) and unmodelled load.

With `--plants strangers`, the plants are two draws of each structure of `benchmarks.strangers`, which differ from their
model in every equation. They have the model and the age of readings of their data sheets, and `mpc.robust_weights`.
Their broken cables leave the muscle free to contract, which lowers its pressure. With `--plants identified` the same
strangers have the models that `fit_joint` and `fit_motion` find in their logs.

Delays count from the onset, and from the first moment at which the fault has an effect: a stuck valve without commands
has none. A fault is named correctly if it alone is suspected, as one of a group if others are as well, and wrongly if
it is not among the suspects; counted at the alarm, and one second later (or at the end of the run).

The output is `faults.csv` (every run) and `faults.md`, or `faults_strangers` and `faults_identified`. The full
benchmark takes half an hour of one processor; `--quick` takes one run of each fault and trajectory, `--share 0.2` a
fifth of everything, but all runs of strangers without a fault.
"""
