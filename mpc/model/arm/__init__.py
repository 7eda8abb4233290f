"""Arms: mechanisms whose muscles move bodies, with their equations of motion."""
