"""Comparison of controllers on joints that differ from their model.

    python -m benchmarks.closed_loop [--quick] [--processes 2] [--out benchmarks/results]

Every controller gets the same model (Sarosi's muscles, nominal), the same knowledge of dead time, dead band and a share
of the friction, the same shaped and previewed references and the same limits. `pid` is the usual one, which
differentiates the encoder's angle; `predictive-pid` feeds back the angle and velocity that the MPC's observer and model
predict for the end of the dead time. The friction of the plant is Maxwell slip (`mpc.model.friction.maxwell_slip`),
with widths that follow P1 + P2 and a memory of reversals; the controllers assume three quarters of Dahl's, which
follows the muscles' pull, with the same loop width at one pressure. So no controller has the true model. Variants
include plants with Dahl's friction and without friction.

Fairness. There is one tuning for all plants, made on other seeds (from 101; the report has those from 41). The PIDs'
gains come from numerical optimisation (`benchmarks/closed_loop/tuning.py`) of this report's figures on the standard
plant itself. The numbers of MPC and observer were chosen by hand after a similar search, on four plants with Dahl's
friction, and not changed for this one; the LQR has the MPC's weights, with four times that of the rate. This favours
the PIDs on the standard plant, at a cost on others. They become unstable if friction, which damps this joint, is
assumed but absent: its compensation then drives the joint. Gentler gains limit-cycle there, or become unstable as well;
without assumed friction ("all but friction") a PID can be calm. The MPC tolerates the same wrong assumption. Gains
placed by the textbook instead of tuned are included. A run with an error above 45° is called unstable and has no
figures, which would not describe tracking.

An unmodelled load of 1 N·m comes half-way (in the stiffness step: at 0.5 s). Angle errors count from the end of the
first rest, in which the loop settles, to the load; "with load" to the end of the run. On the variants of the standard
plant controllers assume the same effects as on the standard one. On plants with a single effect, and on the one with
all but friction, they assume the true ones; the cost of assuming absent effects is shown for the nominal plant.

The output is `closed_loop.csv` (every run), `closed_loop_push.csv` (every push) and `closed_loop.md` (medians over the
seeds, against requirements). K errors are against the plant's true stiffness. Air is the sum of the rises of both
pressures after the first rest [bar]; a muscle's volume times its part of that is the volume of air at 1 bar, except for
the change of the muscle's volume. The full benchmark takes about 10 minutes with two free processors; `--quick` runs
one seed of everything.
"""
