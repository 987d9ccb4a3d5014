"""Agreement, and intervals clustered by object."""
