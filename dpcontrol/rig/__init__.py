"""A rig over UDP, and an example of one."""
