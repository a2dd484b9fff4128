"""A client of the service: the same encode, on another machine."""

from sgmethod.errors import extra

with extra("client"):
    from sgmethod.client.client import Client, RemoteEncoded
    from sgmethod.client.many import encode_many

__all__ = ["Client", "RemoteEncoded", "encode_many"]
