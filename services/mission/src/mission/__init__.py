"""The ground station's side of an experiment: missions written once against the Fleet interface."""
