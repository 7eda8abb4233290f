"""Export of controller and observer of a joint as C: sizes, numbers, friction, QP solver and demonstrations."""
