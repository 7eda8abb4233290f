"""Mechanisms: are the answers optimal, is what is beyond reach proved to be, and how long does it take?"""
