"""Picture formats, one module for each: what its files are called, how they begin, who reads and who writes them.

formats.py lists them. What else says something of formats asks it: the command line, the service, its sandbox and its
OpenAPI document; tests name every list in the page or in a document that is out of date. A new format is a module here
and its name in that list.
"""
