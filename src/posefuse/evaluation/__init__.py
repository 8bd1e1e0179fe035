"""Estimate and truth to figures."""
