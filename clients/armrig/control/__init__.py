"""Control laws: conversion, design, and check of their margins."""
