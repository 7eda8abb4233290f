"""The allocators against the analytic inverse: feasibility, accuracy, time, and what the warm start gains.

    python -m benchmarks.allocators [--quick] [--out benchmarks/results]

targets → contenders → effect, cost → truth (aborts where an answer is not what it claims) → measures, timing,
warm_start → comparison → summary, figures, report
"""
