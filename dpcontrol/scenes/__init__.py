"""Itinerary and model files; plans and runs made from them."""
