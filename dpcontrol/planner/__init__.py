"""The planner: a local page in the browser on which itineraries are put together by pointing.

server      the address, its token, and who may connect
session     what one page has chosen and made; survives a reload of the page
draft       the itinerary's text, how it is changed, and where its mistakes are
worker      a process that does the long work, one job at a time; may be killed at any moment
shown       what the page draws, as numbers
static      the page: one HTML file, one style sheet, one ES module
"""
