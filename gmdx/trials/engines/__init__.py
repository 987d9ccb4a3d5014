"""What steps trials."""
