"""Runs, campaigns, nights and preflights of a plan.

They share the closed loop.
"""
