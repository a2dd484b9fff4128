"""What the web process has done elsewhere: headers of images read, pictures drawn.

An errand and an open file come in, wait until it is their client's turn, and go to a helper process, which is confined.
The answer leaves, or the reason why there is none; a helper that takes too much is ended, and harms nobody else.
"""
