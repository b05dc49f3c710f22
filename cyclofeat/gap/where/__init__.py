"""The first stage of the gap: where measured and simulated torque disagree."""
