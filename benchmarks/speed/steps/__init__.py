"""Control steps: their loops, rivals and tails."""
