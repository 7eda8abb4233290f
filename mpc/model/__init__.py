"""What a joint does and what is known of it: plants, friction, compensation, faults."""

__all__: list[str] = []
