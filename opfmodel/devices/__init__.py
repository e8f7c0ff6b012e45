"""Devices: components connected to a bus, one file each, convex in every formulation."""
