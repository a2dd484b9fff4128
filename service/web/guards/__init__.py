"""What stands before the routes.

Connections and requests come in, and are counted, measured and checked before a body is read.
What may pass goes on to a route; the rest is answered here with a problem document.
"""
