"""Reproduction of attitude from retransmitted carriers on Yamal-200 (Sevast'yanov)."""
