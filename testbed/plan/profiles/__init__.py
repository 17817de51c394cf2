"""Link profiles: from a readable file to a plan of data, and from the plan to commands for the kernel.

units     figures with their units
reading   a file and those it inherits from, checked against the schema -> `Profile`
draws     seeds, and the times of outages and bursts
resolve   profile, topology, experiment, attempt -> `LinksPlan`, which every shaper takes
checks    checks beyond the schema: figures that do not fit together
directed  plan -> the directed links that are shaped, each with its states
kernel    plan -> `ip` and `tc` commands
run_plan  plan -> the file with a run's links for `net`
"""
