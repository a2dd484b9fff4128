"""A client of the service: the same encode, on another machine.

An image file and a budget come in and go to a server.
The .sg file leaves, with its figures and its trace; every failure is a ServerError.
"""

from sgmethod.errors import extra

with extra("client"):
    from sgmethod.client.client import Client, RemoteEncoded
    from sgmethod.client.many import encode_many

__all__ = ["Client", "RemoteEncoded", "encode_many"]
