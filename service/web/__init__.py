"""The web process.

Requests come in, pass the guards, and reach a route.
Answers leave: JSON, pictures, bitstreams, or a problem document.
"""
