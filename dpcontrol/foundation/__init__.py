"""Errors, files, caches, processes and checked tables for every package."""
