"""The fourth stage of the gap: how far it shrank on recordings held out."""
