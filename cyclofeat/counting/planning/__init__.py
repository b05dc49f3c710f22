"""Planning of measurements: how long to record, how much wear shows."""
