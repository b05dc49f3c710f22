"""The joint posterior beside other methods that learn from the same simulated rigs."""
