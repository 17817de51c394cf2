"""All experiments in all arms on all profiles, as one run that can be broken off and gone on with."""
