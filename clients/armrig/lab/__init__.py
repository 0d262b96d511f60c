"""Operation of a laboratory: boards, keys, routers, services, recorders, hosts."""
