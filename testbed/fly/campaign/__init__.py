"""All experiments in all arms on all profiles, as one run that can be interrupted and resumed."""
