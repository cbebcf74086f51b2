"""The planner, a local web page for building itineraries with the mouse.

server      HTTP server with access control by token
session     state of one page, which survives a reload
draft       text of the itinerary, with edits and error positions
worker      process for long jobs, which may be killed at any time
shown       data that the page draws, as numbers
static      the page as one HTML file, one style sheet and one ES module
"""
