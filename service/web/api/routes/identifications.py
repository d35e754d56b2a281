"""Identification: the windows to learn from, and the jobs that learn."""

from typing import Annotated

from fastapi import APIRouter, Header, Path
from starlette.requests import Request
from starlette.responses import Response

from service.bus.commands import Identifications
from service.documents.identification import JobDocument, JobList, WindowList
from service.domain.requests import IdentificationRequest
from service.domain.roles import ENGINEER
from service.web import worker
from service.web.api.access import LOCATION, RETRY_AFTER, secured
from service.web.api.cursors import LIMIT, Cursor, Limit, next_link, page_of
from service.web.api.deps import Asset, Context, json_response
from service.web.api.problems import Problem, parameter_problem
from service.web.api.trail import ChangeLine
from service.web.api.turns import study

RETRY_AFTER_S = 2
#: Marks the answer to a call that was sent again: it changed nothing.
REPLAYED = "Idempotent-Replayed"

router = APIRouter(prefix="/assets/{asset_id}", tags=["identification"])

JobId = Annotated[str, Path(max_length=64, description="The job's id.")]


@router.get(
    "/windows",
    response_model=WindowList,
    summary="List low-risk windows",
    **secured(ENGINEER, 404),
)
async def list_windows(asset: Asset, request: Request) -> Response:
    """Contiguous good data inside the low-risk region, with operating points and score."""
    return json_response(
        WindowList(items=list(await study(request, asset, "windows", worker.windows)))
    )


@router.post(
    "/identifications",
    status_code=202,
    response_model=JobDocument,
    summary="Start an identification",
    **secured(
        ENGINEER,
        404,
        409,
        audit="identification.start",
        responses={202: {"headers": LOCATION | RETRY_AFTER}},
    ),
)
async def post_identification(
    context: Context,
    asset: Asset,
    line: ChangeLine,
    request: IdentificationRequest,
    http_request: Request,
    idempotency_key: Annotated[
        str | None,
        Header(
            alias="Idempotency-Key",
            min_length=1,
            max_length=200,
            description="A second call with the same key and body answers with the same job.",
            examples=["shift-17"],
        ),
    ] = None,
) -> Response:
    """Queue a background job; `Location` names where its progress is."""
    job, created = await context.cell(Identifications).create(
        asset.id, request, idempotency_key, line.who, line
    )
    headers = {
        "Location": f"{http_request.url.path}/{job.id}",
        "Retry-After": str(RETRY_AFTER_S),
    }
    if not created:
        headers[REPLAYED] = "true"
    return json_response(job, 202, headers)


@router.get(
    "/identifications",
    response_model=JobList,
    summary="List identification jobs",
    **secured(ENGINEER, 404),
)
async def list_identifications(
    context: Context, asset: Asset, request: Request, limit: Limit = LIMIT, cursor: Cursor = None
) -> Response:
    """All jobs of the asset, those of earlier runs of the service too."""
    jobs = await context.cell(Identifications).jobs(asset.id)
    page, following = page_of(jobs, limit, cursor, lambda job: job.id)
    return json_response(
        JobList(items=list(page), next=following), headers=next_link(request, following)
    )


@router.get(
    "/identifications/{job_id}",
    response_model=JobDocument,
    summary="Get an identification job",
    **secured(ENGINEER, 404),
)
async def get_identification(context: Context, asset: Asset, job_id: JobId) -> Response:
    """Status, progress, best fitness, and the model version that came of it."""
    job = await context.cell(Identifications).job(asset.id, job_id)
    if job is None:
        raise _no_job(asset, job_id)
    return json_response(job)


@router.delete(
    "/identifications/{job_id}",
    response_model=JobDocument,
    summary="Cancel an identification job",
    **secured(ENGINEER, 404, audit="identification.cancel"),
)
async def delete_identification(
    context: Context, asset: Asset, job_id: JobId, line: ChangeLine
) -> Response:
    """Stop a job that is queued or running; one that has ended stays as it is."""
    job = await context.cell(Identifications).cancel(asset.id, job_id, line)
    if job is None:
        raise _no_job(asset, job_id)
    return json_response(job)


def _no_job(asset: Asset, job_id: str) -> Problem:
    return parameter_problem("job_id", f"asset {asset.id!r} has no identification {job_id!r}", 404)
