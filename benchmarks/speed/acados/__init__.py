"""acados as a rival, and the QP alone against HPIPM, with which acados solves its QPs.

rti (a step of acados's real-time iteration)
recorded (QPs of closed loops) → stages (the same QP as HPIPM takes it) → library (HPIPM by its C interface) → alone

What acados needs is not in a wheel of its own name. Its libraries, headers and `t_renderer` are looked for in
`$ACADOS_SOURCE_DIR`, its Python interface on the path; without them the rows say so.
"""
