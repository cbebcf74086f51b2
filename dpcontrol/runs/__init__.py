"""Runs, campaigns, nights and preflights of a plan, which share the closed loop."""
