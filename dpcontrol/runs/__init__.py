"""Runs, campaigns, nights and preflights of a plan, and the closed loop that they share."""
