"""Link profiles: from a file that a person reads to a plan of data, and from the plan to commands for the kernel.

units     figures with their units
reading   a file and what it inherits, checked against the schema -> `Profile`
draws     seeds, and the times of outages and bursts
resolve   profile, topology, experiment, attempt -> `LinksPlan`, which every shaper takes
checks    what the schema cannot say: figures that do not fit together
directed  plan -> the directed links that are shaped, each with its states
kernel    plan -> `ip` and `tc` commands
run_plan  plan -> what `net` gets of a run's links
"""
