"""Identification of joints and motions: errors, intervals and plans on joints with known truth."""
