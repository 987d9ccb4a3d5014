"""How much labels depend on the parameters of trials."""
