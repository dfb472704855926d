"""Keystores for secured DDS, as SROS 2 reads them."""
