"""acados as a rival, and the QP alone against HPIPM, with which acados solves its QPs.

rti (a step of acados's real-time iteration)
recorded (QPs of closed loops) → stages (the same QP as HPIPM takes it) → library (HPIPM by its C interface) → alone

Libraries, headers and `t_renderer` of acados are looked for in `$ACADOS_SOURCE_DIR`, as acados has it, and
`acados_template` on the path; without them the rows say so. One wheel has them all, and is unpacked, not installed,
because it brings a CasADi of its own:

    pip download --no-deps comma-deps-acados && unzip -q comma_deps_acados-*.whl && cd comma_deps_acados-*/purelib
    export ACADOS_SOURCE_DIR=$PWD/acados/install PYTHONPATH=$PWD/acados
"""
