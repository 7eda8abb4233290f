"""Results are shown to a person here: tables, pictures, sliders."""
