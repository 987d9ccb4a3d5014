"""The command `gmdx`."""
