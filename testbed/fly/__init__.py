"""Flies what is planned, in containers, and writes down what happened: a results folder."""
