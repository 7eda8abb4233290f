"""Plan of the experiment for a joint's fit: setpoints, a weight, and the most informative supplement."""
