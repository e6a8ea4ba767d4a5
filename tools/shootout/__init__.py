"""Every law times every allocator through one scenario, and what each pair costs: `hilsat shootout`."""
