"""Networks of policies and of learned rewards."""
