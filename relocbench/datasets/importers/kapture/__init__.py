"""Folders in the kapture format of Naver Labs Europe."""
