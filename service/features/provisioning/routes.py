"""Provisioning: assets that are made, changed and removed while the service runs."""

from fastapi import APIRouter

from service.features.provisioning import asset_routes, list_routes
from service.features.provisioning.requests import AssetsToImport
from service.web.api.middleware import CSV, KIB, Upload

router = APIRouter()
router.include_router(list_routes.router)
router.include_router(asset_routes.router)
#: Bodies that the routes read themselves.
BODIES = (AssetsToImport,)
UPLOADS = (Upload("/assets:import", 8192 * KIB, (CSV,)), Upload("/assets:remove", 8192 * KIB))
