"""The QP alone: ours against HPIPM, with which acados solves the QP of every step of its real-time iteration.

recorded (QPs of closed loops) → stages (the same QP as HPIPM takes it) → library (HPIPM by its C interface) → alone
"""
