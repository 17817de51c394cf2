"""What is to be flown: experiments, factors, link profiles, topology, missions of one's own."""
