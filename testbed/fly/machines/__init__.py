"""A fleet over several machines: `reach` their Docker daemons, join them in a `swarm`, lay its `overlays`, and `spread`
the containers.
"""
