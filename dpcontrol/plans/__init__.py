"""Model and itinerary files, and the plans made from them."""
