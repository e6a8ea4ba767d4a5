"""Campaigns: many runs from one file, one answer: `hilsat campaign`."""
