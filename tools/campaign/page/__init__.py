"""The page of a campaign: one HTML file to read, print or send."""

from tools.campaign.page.page import write_page

__all__ = ["write_page"]
