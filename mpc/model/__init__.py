"""What a joint does and what is known of it is modelled here: plants, friction, compensation, faults."""
