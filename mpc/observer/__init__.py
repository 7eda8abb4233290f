"""What a joint is doing is estimated from its sensors: the state, the load, and what may be broken."""
