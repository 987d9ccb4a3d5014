"""What the computer has, and how work is spread over it."""
