"""The plan of flights: experiments, factors, link profiles, topology, users' own missions."""
