"""The allocators against the analytic inverse: feasibility, accuracy, time, and the gain by the warm start.

    python -m benchmarks.allocators [--quick] [--out benchmarks/results]

targets → contenders → effect, cost → truth (aborts at a false claim) → measures, timing, warm_start → comparison →
summary, figures, report
"""
