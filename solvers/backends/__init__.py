"""Back ends, one file each: what they accept, options, status map, solve, multipliers."""
