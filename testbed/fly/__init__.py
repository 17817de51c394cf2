"""Flies plans in containers and records the flights in a results folder."""
