"""Back ends, one file each: accepted programs, options, status map, solve, multipliers."""
