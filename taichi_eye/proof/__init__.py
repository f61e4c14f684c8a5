"""Proof: exact answers met (`verify`), where the methods fail (`stability`), the paper's claims tested (`claims`)."""
