"""Reproduction of the orbital-frame control of Meteor-M No. 2 (Belenkii, Vasilev, Semenov)."""
