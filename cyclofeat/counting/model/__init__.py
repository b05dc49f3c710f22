"""Models of whole recordings: windows, a counter, refusals."""
