"""A rig over UDP: protocol, client, example bench and commissioning."""
