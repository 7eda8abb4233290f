"""The experiment for a joint's fit is planned here: setpoints, a weight, and what else would tell most."""
