"""Figures of the report: drawn as marks on a plane, for the page as SVG and for papers as PDF."""
