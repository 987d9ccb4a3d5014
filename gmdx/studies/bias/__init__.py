"""How much labels depend on the engine."""
