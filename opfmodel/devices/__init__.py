"""Devices: kinds of equipment, one file each, convex in every formulation."""
