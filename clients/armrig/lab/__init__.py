"""What who runs a laboratory does: boards, keys, routers, services, recorders, hosts."""
