"""The controller and the observer of a joint as C: sizes, numbers, friction, the solver of the QP, demonstrations."""
